"""Machines: wiring, rates, snapshots, failures of the physics, and what is refused."""

import subprocess
import sys

import mujoco
import numpy as np
import pytest

from servogym.envs import Machine, gantry, linear_axis, rotary_axis
from servogym.envs.engine.residence import Residence

SLIDE = """
<mujoco><option timestep="{timestep}"/>
 <worldbody><body><joint name="j" type="{joint}" axis="1 0 0"/><geom size=".1" mass="2"/></body>
 </worldbody><actuator>{actuator}</actuator></mujoco>
"""
MOTOR = '<motor name="a" joint="j" gear="100"/>'


def mjcf(actuator=MOTOR, joint="slide", timestep=0.00025):
    return SLIDE.format(actuator=actuator, joint=joint, timestep=timestep)


def test_the_contract():
    machine = linear_axis(drive="generic", payload=5.0)
    x = machine.drives["x"]
    x.write(0x6060, 0, 8)
    assert x.read(0x6041, 0) == x.read("statusword")
    x.write("target_position", 10_000)
    machine.step(100)
    assert machine.time == pytest.approx(0.05)
    assert isinstance(machine.model, mujoco.MjModel)
    assert isinstance(machine.data, mujoco.MjData)
    assert machine.physics_steps == 2
    assert machine.data.time == pytest.approx(0.05)


def test_reset_leaves_the_drive_powered_disabled_and_not_referenced():
    machine = linear_axis()
    x = machine.drives["x"]
    x.write("profile_velocity", 4711)
    machine.step(50)
    machine.reset(positions={"x": 0.12})
    assert machine.time == 0
    assert machine.data.qpos[0] == 0.12
    machine.step()
    assert x.describe().startswith("0250h SWITCH_ON_DISABLED")
    assert x.read("position_actual_value") == 0, "an incremental encoder begins where it is"
    assert not x.axis.homed
    assert x.read("profile_velocity") == 4711, "commissioning is kept"


def test_the_range_of_a_joint_is_that_of_mujoco_and_none_is_infinite():
    machine = gantry()
    for name in machine.drives:
        number = machine.model.dof_jntid[machine.couplings[[*machine.drives].index(name)].dof]
        assert machine.range(name) == tuple(machine.model.jnt_range[number])
    assert rotary_axis().range("x") == (-np.inf, np.inf)
    with pytest.raises(KeyError, match="no drive 'q': choose one of x, y, z"):
        machine.range("q")


def test_a_hinge_and_a_slide_with_drives_of_their_own():
    text = """
    <mujoco><option timestep="0.00025" gravity="0 0 0"/><worldbody>
     <body><joint name="s" type="slide"/><geom size=".1" mass="2"/>
      <body><joint name="h" type="hinge"/><geom size=".1" pos=".2 0 0" mass="1"/></body></body>
    </worldbody><actuator><motor name="lift" joint="s" gear="-100"/>
     <motor name="turn" joint="h" gear="50"/></actuator></mujoco>"""
    machine = Machine.from_mjcf(text, {"turn": "generic", "lift": "generic"})
    for drive in machine.drives.values():
        drive.write("modes_of_operation", 3)
        drive.write("target_velocity", 500_000)
        drive.write("following_error_window", 0xFFFFFFFF)
        drive.write("velocity_control_gain", 20_000)
        for word in (6, 7, 15):
            drive.write("controlword", word)
            machine.step(2)
    machine.step(500)
    lift, turn = machine.data.joint("s").qvel[0], machine.data.joint("h").qvel[0]
    speed = 500_000 / 2**20 * 2 * np.pi
    assert lift == pytest.approx(-speed / 100, rel=0.03), "a negative gear turns the direction"
    assert turn == pytest.approx(speed / 50, rel=0.03)


@pytest.mark.parametrize(
    ("actuator", "message"),
    [
        ('<motor name="b" joint="j"/>', r"no actuator or joint 'a'.* \['b'\] and the joints"),
        ('<motor name="a" joint="j" gear="0"/>', "gear = 0.0 rad/m is out of range"),
        ('<motor name="a" joint="j" gear="1e300"/>', r"gear = 1e\+300 rad/m is out of range"),
        ('<position name="a" joint="j" kp="5"/>', "is not a plain motor"),
        ('<velocity name="a" joint="j" kv="5"/>', "is not a plain motor"),
        ('<general name="a" joint="j" dyntype="filter" dynprm="1"/>', "is not a plain motor"),
        ('<general name="a" body="world" gear="1"/>', "slide or hinge joint"),
    ],
)
def test_an_actuator_that_cannot_take_a_drive(actuator, message):
    if "body=" in actuator:
        actuator = '<adhesion name="a" body="b" ctrlrange="0 1"/>'
    text = mjcf(actuator).replace("<body>", '<body name="b">')
    with pytest.raises(ValueError, match=message):
        Machine(mujoco.MjModel.from_xml_string(text), {"a": "generic"})


def test_a_free_joint_is_refused():
    text = mjcf(joint="ball").replace(' axis="1 0 0"', "")
    with pytest.raises(ValueError, match="slide or hinge joint"):
        Machine.from_mjcf(text, {"a": "generic"})


@pytest.mark.parametrize("timestep", [0.0003, 0.0005, 0.001])
def test_a_physics_step_that_does_not_fit_is_refused_with_both_numbers(timestep):
    with pytest.raises(ValueError, match=rf"250 µs .* {timestep * 1e6:g} µs"):
        Machine(mujoco.MjModel.from_xml_string(mjcf(timestep=timestep)), {"a": "generic"})


def test_finer_physics_fits():
    machine = Machine.from_mjcf(mjcf(timestep=0.0000625), {"a": "generic"})
    assert machine.physics_steps == 8


@pytest.mark.parametrize(
    ("data", "message"),
    [("0 1", "3 finite numbers"), ("0 1 2 3", "3 finite numbers")],
)
def test_a_switch_that_is_not_three_numbers(data, message):
    custom = f'<custom><numeric name="a.home_switch" data="{data}"/></custom><worldbody>'
    with pytest.raises(ValueError, match=message):
        Machine.from_mjcf(mjcf().replace("<worldbody>", custom), {"a": "generic"})


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match="unknown drive model 'acme'"):
        linear_axis(drive="acme")
    with pytest.raises(ValueError, match=r"drives is empty: .* actuator or joint of \['\w"):
        Machine.from_mjcf(mjcf(), {})
    with pytest.raises(TypeError, match=r"'robot.xml': give a mujoco.MjModel; .*from_mjcf"):
        Machine("robot.xml", {"a": "generic"})
    with pytest.raises(ValueError, match=r"there is no MJCF file robot.xml"):
        Machine.from_mjcf("robot.xml", {"a": "generic"})
    machine = linear_axis()
    with pytest.raises(ValueError, match=r"out of the joint's range -0.02..0.52 m"):
        machine.reset(positions={"x": 0.6})
    with pytest.raises(ValueError, match="no drive 'y'"):
        machine.reset(positions={"y": 0.0})
    with pytest.raises(ValueError, match="nan"):
        machine.reset(positions={"x": float("nan")})


def moving():
    machine = linear_axis()
    machine.reset(positions={"x": 0.1})
    x = machine.drives["x"]
    x.write("modes_of_operation", 3)
    x.write("target_velocity", 300_000)
    for word in (6, 7, 15):
        x.write("controlword", word)
        machine.step(2)
    machine.step(100)
    return machine


def test_snapshot_and_restore_continue_bit_by_bit():
    machine = moving()
    snapshot = machine.snapshot()
    machine.step(1000)
    first = machine.snapshot()
    machine.step(17)
    machine.restore(snapshot)
    machine.step(1000)
    assert machine.snapshot() == first


def test_another_process_continues_bit_by_bit_the_same(tmp_path):
    machine = moving()
    (tmp_path / "snapshot").write_bytes(machine.snapshot())
    machine.step(1000)
    code = (
        "import sys, pathlib; from servogym.envs import linear_axis; m = linear_axis();"
        "p = pathlib.Path(sys.argv[1]); m.restore(p.joinpath('snapshot').read_bytes());"
        "m.step(1000); p.joinpath('result').write_bytes(m.snapshot())"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True)
    assert (tmp_path / "result").read_bytes() == machine.snapshot()


def test_two_machines_are_bit_identical_and_share_nothing():
    first, second = moving(), moving()
    assert first.snapshot() == second.snapshot()
    first.drives["x"].write("target_velocity", -1)
    first.step(50)
    second.step(1)
    assert second.drives["x"].read("target_velocity") == 300_000


def test_a_snapshot_of_another_machine_is_refused():
    with pytest.raises(ValueError, match="of another machine"):
        linear_axis().restore(Machine.from_mjcf(mjcf(), {"a": "generic"}).snapshot())
    with pytest.raises(ValueError, match="take a new one"):
        linear_axis().restore(b"rubbish")
    with pytest.raises(ValueError, match="checksum"):
        linear_axis().restore(linear_axis().snapshot()[:-5])


@pytest.mark.parametrize("where", ["qpos", "qvel"])
def test_physics_that_fails_is_a_named_fault_and_no_torque(where, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    machine = moving()
    getattr(machine.data, where)[0] = float("nan")
    machine.step(20)
    x = machine.drives["x"]
    assert x.state.name == "FAULT"
    assert x.fault.startswith("7305h")
    assert machine.data.ctrl[0] == 0.0
    machine.reset(positions={"x": 0.2})
    machine.step(20)
    assert np.isfinite(machine.data.qpos).all()
    assert x.state.name == "SWITCH_ON_DISABLED"


def test_an_engaged_brake_holds_a_vertical_axis():
    text = """
    <mujoco><option timestep="0.00025"/>
     <custom><numeric name="z.brake_torque" data="3"/></custom>
     <worldbody><body><joint name="z" type="slide" axis="0 0 1"/><geom size=".1" mass="5"/></body>
     </worldbody><actuator><motor name="z" joint="z" gear="628"/></actuator></mujoco>"""
    machine = Machine.from_mjcf(text, {"z": "generic"})
    z = machine.drives["z"]
    assert z.read("brake_fitted") == 1
    machine.step(1000)
    assert abs(machine.data.qpos[0]) < 1e-3
    z.write("bit_mask", 1)  # released by hand: it falls
    machine.step(1000)
    assert machine.data.qpos[0] < -0.5


def test_machines_that_share_model_and_data_are_bit_for_bit_alone():
    def machines():
        return [linear_axis(payload=payload, stiffness=2e4) for payload in (1.0, 5.0, 9.0)]

    def run(group):
        for k in range(30):
            for i, machine in enumerate(group):
                if k == 0:
                    machine.reset(positions={"x": 0.1 + 0.1 * i})
                machine.drives["x"].write("controlword", (0x06, 0x07, 0x0F)[min(k, 2)])
                machine.step(1 + (k + i) % 3)
        return [machine.snapshot() for machine in group]

    alone, together = machines(), machines()
    residence = Residence(together[0].model, together[0].data)
    for machine in together:
        machine.share(residence)
    body = together[2].model.body("payload").id
    assert [float(m.model.body_mass[body]) for m in together] == [1.0, 5.0, 9.0]
    one, other = run(alone), run(together)
    for a, b in zip(one, other, strict=True):
        assert a == b
