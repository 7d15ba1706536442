"""Robots from outside: any MJCF gets drives, is commissioned, homes, moves and holds."""

import math
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest

from servogym.drive.master import Master, Refused
from servogym.drive.model.model import load
from servogym.envs import Machine, commission_joint
from servogym.envs.masters.port import MachinePort

ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
DRIVES = ("generic", "kollmorgen_akd", "festo_cmmp_as")

# in a vertical plane; a servo with limits and a filter, and a joint without an actuator
ARM = """
<mujoco><compiler angle="radian" autolimits="true"/><option timestep="0.002"/>
 <default><position forcerange="-1 1" kp="50"/></default>
 <worldbody><body>
  <joint name="shoulder" axis="0 -1 0" range="-2 2" actuatorfrcrange="-1 1"/>
  <geom type="capsule" fromto="0 0 0 .4 0 0" size=".03" mass="3" contype="0" conaffinity="0"/>
  <body pos=".4 0 0"><joint name="elbow" axis="0 -1 0" range="-2.5 2.5"/>
   <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="2" contype="0" conaffinity="0"/>
 </body></body></worldbody>
 <actuator>
  <position name="servo" joint="shoulder" ctrlrange="-2 2" timeconst="0.05" dampratio="1"/>
 </actuator>
 <sensor><actuatorfrc actuator="servo"/></sensor>
 <keyframe><key name="ready" qpos="1 1" ctrl="1" act="1"/></keyframe></mujoco>
"""
# two hinges, a vertical quill with a holding brake, and its rotation without end
SCARA = """
<mujoco><compiler angle="degree" autolimits="true"/><option timestep="0.001"/>
 <default><geom contype="0" conaffinity="0"/></default>
 <custom><numeric name="z.brake_torque" data="1"/></custom>
 <worldbody><body><joint name="j1" axis="0 0 1" range="-130 130"/>
  <geom type="box" pos=".15 0 0" size=".15 .05 .04" mass="4"/>
  <body pos=".3 0 0"><joint name="j2" axis="0 0 1" range="-140 140"/>
   <geom type="box" pos=".12 0 0" size=".12 .04 .03" mass="3"/>
   <body pos=".25 0 0"><joint name="z" type="slide" axis="0 0 1" range="-.2 0"/>
    <geom type="cylinder" size=".015 .15" mass="1"/>
    <body pos="0 0 -.15"><joint name="r" axis="0 0 1"/>
     <geom type="box" size=".06 .02 .01" mass="1.5"/>
 </body></body></body></body></worldbody>
 <actuator><velocity name="a1" joint="j1" kv="20"/><position joint="j2" kp="200" kv="20"/>
  <general name="quill" joint="z" biastype="affine" gainprm="100" biasprm="0 -100 -5"/>
  <motor name="spin" joint="r" gear="30"/></actuator></mujoco>
"""
# MJCF, pose to begin with, targets (m or rad) by the drive's name
ROBOTS = {
    "arm": (ARM, {"shoulder": -0.2}, {"shoulder": 0.9, "elbow": -1.1}),
    "scara": (SCARA, {}, {"a1": 1.2, "j2": -0.8, "z": -0.12, "spin": 4.0}),
    "inverted_pendulum": ("inverted_pendulum.xml", {}, {"slide": 0.3}),
    "reacher": ("reacher.xml", {}, {"joint0": 2.5, "joint1": -1.0}),
    "half_cheetah": ("half_cheetah.xml", {}, {"bthigh": 0.3, "fshin": -0.2}),
    "ant": (
        "ant.xml",
        {"ankle_1": 0.8, "ankle_2": -0.8, "ankle_3": -0.8, "ankle_4": 0.8},
        {"hip_1": 0.2, "ankle_1": 0.9, "ankle_2": -0.7, "ankle_3": -0.8, "ankle_4": 0.7},
    ),
    "swimmer": ("swimmer.xml", {}, {"motor1_rot": 0.5}),  # in a fluid that asks for a large motor
    "cartpole": ("cartpole.xml", {}, {"slider": -0.5}),
    "acrobot": ("acrobot.xml", {"shoulder": 3.0}, {"shoulder": 2.5, "elbow": 0.4}),
    "manipulator": ("manipulator.xml", {}, {"root": 0.7, "arm_shoulder": -0.5, "elbow": 0.6}),
}
OF_DM_CONTROL = ("cartpole", "acrobot", "manipulator")


def mjcf_of(robot):
    mjcf = ROBOTS[robot][0]
    if mjcf.lstrip().startswith("<"):
        return mjcf
    if robot in OF_DM_CONTROL:
        reason = "dm_control is large, so it is not among the test dependencies"
        return Path(pytest.importorskip("dm_control", reason=reason).__path__[0]) / "suite" / mjcf
    return ASSETS / mjcf


def position(machine, name):
    coupling = machine.couplings[list(machine.drives).index(name)]
    return float(machine.data.qpos[coupling.qpos])


@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass'")  # of half_cheetah
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("robot", ROBOTS)
def test_a_robot_homes_where_it_stands_and_arrives_in_the_position_window(robot, drive):
    _, pose, targets = ROBOTS[robot]
    machine = Machine.from_mjcf(
        mjcf_of(robot), dict.fromkeys(targets, drive), gears=dict.fromkeys(targets, 100.0)
    )
    machine.reset(pose)
    for name in targets:
        commission_joint(machine, name)
    place = {name: position(machine, name) for name in targets}
    port = MachinePort(machine, cycles=5)
    masters = {name: Master(port, name) for name in targets}
    for master in masters.values():
        master.enable()
    sagged = {}  # a limp joint sinks until its drive is enabled
    for name, master in masters.items():
        sagged[name] = position(machine, name) - place[name]
        master.home()
        assert abs(sagged[name]) < 0.01
    for name, target in targets.items():
        masters[name].move_to(target)
    machine.step(200)
    for name, target in targets.items():
        x = machine.drives[name]
        window = x.read("position_window")
        assert abs(x.read("position_actual_value") - round(target * 1e6)) <= window
        arrived = position(machine, name) - sagged[name]
        assert arrived == pytest.approx(target, abs=2 * window * 1e-6), name


@pytest.mark.parametrize("drive", DRIVES)
def test_a_joint_holds_its_weight_with_the_torque_of_gravity(drive):
    machine = Machine.from_mjcf(ARM, {"shoulder": drive, "elbow": drive})
    for name in machine.drives:
        commission_joint(machine, name)
        Master(MachinePort(machine), name).enable()
    machine.step(400)
    held = machine.data.qpos.copy()
    torque = np.zeros(2)
    for _ in range(1000):
        machine.step(2)
        torque += machine.axes["torque"] / 1000
    assert machine.data.qpos == pytest.approx(held, abs=20e-6)
    assert torque == pytest.approx(machine.data.qfrc_bias / 100.0, rel=0.01)


def test_the_motor_is_made_as_large_as_the_load_needs():
    heavy = ARM.replace('mass="3"', 'mass="60"')
    rated = []
    for text in (ARM, heavy):
        machine = Machine.from_mjcf(text, {"shoulder": "generic"})
        commission_joint(machine, "shoulder")
        rated.append(machine.drives["shoulder"].read("motor_rated_torque"))
    assert rated[0] == 1270
    horizontal = (60 * 0.2 + 2 * 0.55) * 9.81 / 100.0  # Nm at the shaft
    assert rated[1] == pytest.approx(2 * horizontal * 1e3, rel=0.01)


def test_a_given_acceleration_makes_the_motor_larger():
    machine = Machine.from_mjcf(SCARA, {"j1": "generic"})
    commission_joint(machine, "j1", max_velocity=2.0, max_acceleration=1000.0)
    x = machine.drives["j1"]
    assert x.read("profile_velocity") == 2_000_000
    assert x.read("profile_acceleration") == 1_000_000_000
    inertia = x.read("acceleration_feed_forward") * 1e-9
    wanted = inertia * 1000.0 * 100.0
    assert x.read("motor_rated_torque") * 1e-3 >= wanted / 2 > 1.27


def test_the_gains_count_joints_without_a_drive_as_free():
    inertia = {}
    for names in (("j1",), ("j1", "j2", "z", "r")):
        machine = Machine.from_mjcf(SCARA, dict.fromkeys(names, "generic"))
        commission_joint(machine, "j1")
        inertia[len(names)] = machine.drives["j1"].read("acceleration_feed_forward") * 1e-9
    mass = np.zeros((4, 4))
    mujoco.mj_fullM(machine.model, machine.data, mass)
    assert inertia[4] == pytest.approx(mass[0, 0] / 100**2, rel=1e-3)
    assert inertia[1] < 0.9 * inertia[4]


def test_an_actuator_becomes_a_motor_and_keeps_name_number_and_sensor():
    machine = Machine.from_mjcf(ARM, {"elbow": "generic", "shoulder": "kollmorgen_akd"})
    model = machine.model
    assert [model.actuator(i).name for i in range(model.nu)] == ["servo", "elbow"]
    assert machine.couplings["ctrl"].tolist() == [1, 0]
    assert model.actuator_gear[:, 0].tolist() == [100.0, 100.0]
    assert not model.actuator_forcelimited.any()
    assert not model.jnt_actfrclimited.any()
    assert model.na == 0, "the filter of the servo is gone"
    assert model.key_ctrl.tolist() == [[0.0, 0.0]]
    rotor = [load(name).rotor_inertia * 100**2 for name in ("kollmorgen_akd", "generic")]
    assert model.dof_armature == pytest.approx(rotor)
    machine.data.ctrl[:] = (0.5, 0.0)
    mujoco.mj_forward(model, machine.data)
    assert machine.data.sensordata[0] == pytest.approx(0.5)
    assert machine.data.qfrc_actuator[0] == pytest.approx(50.0)


def test_a_plain_motor_keeps_its_gear_and_the_joint_its_armature_unless_a_gear_is_given():
    own = Machine.from_mjcf(SCARA, {"spin": "generic"})
    assert own.couplings["gear"][0] == 30.0
    assert own.model.dof_armature[3] == 0.0
    given = Machine.from_mjcf(SCARA, {"spin": "generic"}, gears={"spin": -50})
    assert given.couplings["gear"][0] == -50.0
    assert given.model.dof_armature[3] == pytest.approx(0.6e-4 * 2500)


def test_a_motor_on_a_joint_in_its_parent_takes_a_drive():
    text = SCARA.replace('name="spin" joint=', 'name="spin" jointinparent=')
    assert Machine.from_mjcf(text, {"r": "generic"}).couplings["gear"][0] == 30.0


def test_a_slide_has_a_ball_screw_by_default():
    machine = Machine.from_mjcf(SCARA, {"z": "generic"})
    assert machine.couplings["gear"][0] == pytest.approx(2 * math.pi / 0.02)


def test_a_negative_gear_turns_the_motor_and_not_the_joint():
    machine = Machine.from_mjcf(SCARA, {"j1": "generic"}, gears={"j1": -100})
    commission_joint(machine, "j1")
    master = Master(MachinePort(machine), "j1")
    master.enable()
    master.home()
    master.move_to(0.5)
    assert position(machine, "j1") == pytest.approx(0.5, abs=1e-4)
    assert machine.drives["j1"].axis.shaft_angle == pytest.approx(-50, abs=0.01)
    x = machine.drives["j1"]
    assert x.read("min_position_limit") == pytest.approx(math.radians(-130) * 1e6, abs=1)
    assert x.read("max_position_limit") == pytest.approx(math.radians(130) * 1e6, abs=1)


def test_the_software_limits_are_the_range_of_the_joint_and_an_unlimited_one_has_none():
    machine = Machine.from_mjcf(SCARA, {"j1": "generic", "r": "generic"})
    for name in machine.drives:
        commission_joint(machine, name)
        master = Master(MachinePort(machine), name)
        master.enable()
        master.home()
        if name == "j1":
            with pytest.raises(Refused, match=r"10 rad is beyond the stroke -2.26893\.\.2.26"):
                master.move_to(10.0)
        master.move_to(10.0, relative=name == "j1")
    assert position(machine, "j1") == pytest.approx(math.radians(130), abs=1e-4)
    assert position(machine, "r") == pytest.approx(10.0, abs=1e-3)


def test_an_actuator_without_a_drive_obeys_ctrl():
    machine = Machine.from_mjcf(SCARA, {"j1": "generic"})
    commission_joint(machine, "j1")
    Master(MachinePort(machine), "j1").enable()
    machine.data.ctrl[machine.model.actuator("a1").id + 1] = 0.4  # the position servo of j2
    machine.step(6000)
    assert machine.data.joint("j2").qpos[0] == pytest.approx(0.4, abs=0.01)
    assert machine.data.joint("j1").qpos[0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(
    ("own", "drives", "step"),
    [
        (0.002, ("generic",), 250e-6),
        (0.002, ("generic", "kollmorgen_akd"), 62.5e-6),
        (0.0001, ("generic",), 250e-6 / 3),
        (0.000125, ("generic",), 0.000125),
        (0.002, ("metronix_ars2000",), 208e-6),
    ],
)
def test_the_physics_step_is_the_longest_that_fits(own, drives, step):
    text = SCARA.replace('timestep="0.001"', f'timestep="{own}"')
    machine = Machine.from_mjcf(text, dict(zip(("j1", "j2"), drives, strict=False)))
    assert machine.model.opt.timestep == pytest.approx(step, rel=1e-12)
    machine.step()
    assert machine.data.time == pytest.approx(machine.cycle_time)


FREE = '<mujoco><worldbody><body><freejoint name="f"/><geom size=".1"/></body></worldbody></mujoco>'
BALL = FREE.replace('<freejoint name="f"/>', '<joint name="b" type="ball"/>')
TENDON = ARM.replace(
    "<actuator>",
    '<tendon><fixed name="t"><joint joint="elbow" coef="1"/></fixed></tendon>'
    '<actuator><motor name="pull" tendon="t"/>',
)
TWICE = ARM.replace("<actuator>", '<actuator><velocity name="damper" joint="shoulder" kv="1"/>')


@pytest.mark.parametrize(
    ("mjcf", "names", "gears", "message"),
    [
        (ARM, ["wrist"], {}, r"'wrist': .* \['servo'\] and the joints \['shoulder', 'elbow'\]"),
        (FREE, ["f"], {}, "'f' is a free joint, a drive needs a slide or hinge joint"),
        (BALL, ["b"], {}, "'b' is a ball joint, a drive needs a slide or hinge joint"),
        (TENDON, ["pull"], {}, "'pull' acts on a tendon, a drive needs a slide or hinge joint"),
        (TWICE, ["shoulder"], {}, r"\['damper', 'servo'\]: .* delete all but one"),
        (TWICE, ["servo"], {}, "has 2 actuators"),
        (ARM, ["servo", "shoulder"], {}, "drives 'servo' and 'shoulder' are both on"),
        (ARM, ["elbow"], {"elbow": 0}, r"gears\['elbow'\] = 0 rad/rad is out of range 0.001"),
        (ARM, ["elbow"], {"elbow": 1e300}, r"gears\['elbow'\] = 1e\+300 rad/rad is out of range"),
        (ARM, ["elbow"], {"elbow": math.nan}, "= nan rad/rad is out of range"),
        (SCARA, ["z"], {"z": math.inf}, "= inf rad/m is out of range"),
        (ARM, ["elbow"], {"elbow": "100"}, "= '100' rad/rad is out of range"),
        (ARM, ["elbow"], {"servo": 100}, r"gears: there is no drive 'servo': choose one of elbow"),
        (ARM.replace("0.002", "0"), ["elbow"], {}, "timestep = 0.0 s must be finite and above 0"),
    ],
)
def test_what_cannot_take_a_drive_is_named_with_the_fix(mjcf, names, gears, message):
    with pytest.raises(ValueError, match=message):
        Machine.from_mjcf(mjcf, dict.fromkeys(names, "generic"), gears=gears)


def test_drives_with_clashing_rates_are_both_named():
    clash = r"drive 'j1' = 500 µs .* drive 'j2' = 416 µs: choose another drive model for one"
    with pytest.raises(ValueError, match=clash):
        Machine.from_mjcf(SCARA, {"j1": "generic", "j2": "metronix_ars2000"})


def test_a_compiled_model_takes_joint_names_but_gets_no_motors():
    text = ARM.replace("0.002", "0.00025")
    with pytest.raises(ValueError, match="'shoulder' is not a plain motor"):
        Machine(mujoco.MjModel.from_xml_string(text), {"shoulder": "generic"})
    with pytest.raises(ValueError, match=r"'elbow' has 0 actuators.*Machine.from_mjcf"):
        Machine(mujoco.MjModel.from_xml_string(text), {"elbow": "generic"})


@pytest.mark.parametrize(
    ("robot", "pose", "drive", "arguments", "message"),
    [
        (ARM, {}, "generic", {"max_velocity": 0}, "max_velocity = 0 must be a finite number"),
        (ARM, {}, "generic", {"max_acceleration": -1.0}, "max_acceleration = -1.0 must be"),
        (ARM, {}, "generic", {"position_unit": math.nan}, "position_unit = nan must be"),
        (ARM, {}, "generic", {"position_unit": 1e-10}, "choose a larger position_unit"),
        (ARM, {}, "generic", {"max_velocity": 1e5}, "profile_velocity.*smaller limits"),
    ],
)
def test_a_commissioning_that_cannot_be_is_named_with_the_fix(
    robot, pose, drive, arguments, message
):
    machine = Machine.from_mjcf(robot, {"shoulder": drive})
    machine.reset(pose)
    with pytest.raises(ValueError, match=message):
        commission_joint(machine, "shoulder", **arguments)


def test_a_joint_out_of_its_range_or_too_light_for_the_drive_is_named():
    machine = Machine.from_mjcf(ASSETS / "ant.xml", {"ankle_1": "generic"})
    with pytest.raises(ValueError, match=r"'ankle_1' stands at 0, out of .*machine.reset"):
        commission_joint(machine, "ankle_1")
    light = SCARA.replace('gear="30"', 'gear="3000"')
    machine = Machine.from_mjcf(light, {"spin": "festo_cmmp_as"})
    with pytest.raises(ValueError, match=r"velocity_control_gain.*another gear than 3000"):
        commission_joint(machine, "spin")
    with pytest.raises(ValueError, match=r"there is no drive 'j1': choose one of spin"):
        commission_joint(machine, "j1")


def test_a_frequency_inverter_is_left_as_it_is():
    machine = Machine.from_mjcf(SCARA, {"r": "bonfiglioli_act"}, gears={"r": 10})
    before = machine.drives["r"].snapshot()
    commission_joint(machine, "r")
    assert machine.drives["r"].snapshot() == before
