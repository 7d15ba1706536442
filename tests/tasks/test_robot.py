"""servogym/Robot-v0: any MJCF, goals for joints or a site; and what is in the way of a joint."""

from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from servogym.drive.master import Master, ServoError
from servogym.envs import Machine, commission_joint
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.masters.port import MachinePort
from servogym.envs.tasks.robot import RobotEnv
from servogym.training.policies import make

REACHER = Path(gym.__file__).parent / "envs/mujoco/assets/reacher.xml"
WALLED = """<mujoco><worldbody>
  <geom name="wall" type="box" pos="0.5 0 0" size="0.02 0.3 0.3"/>
  <body name="arm"><joint name="swing" axis="0 0 1" range="-170 170"/>
    <geom name="beam" type="capsule" fromto="0 0.05 0 0 0.6 0" size="0.02" mass="2"/></body>
  </worldbody></mujoco>"""
HELD = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody>
  <body name="beam"><joint name="swing" axis="0 0 1" {}/>
    <geom type="capsule" fromto="0 0 0 0 0.6 0" size="0.02" mass="2"/></body>
  </worldbody></mujoco>"""
FALLING = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 1"/>
  <body pos="0 0 0.2"><freejoint/><geom name="trunk" size="0.1" mass="5"/>
   <body pos="0 0 0.1"><joint name="swing" axis="0 1 0"/>
    <geom name="rod" type="capsule" fromto="0 0 0.1 0 0 0.4" size="0.02" mass="1"/></body></body>
  </worldbody></mujoco>"""


def towards(env, observation):
    """Each joint to its goal, at a speed in proportion."""
    axes = env.named(observation).axes
    return np.array([np.clip(3.0 * axis.distance, -1, 1) for axis in axes], np.float32)


def test_goals_of_joints_are_reached_and_held():
    env = RobotEnv()
    check_env(env, skip_render_check=True)
    goal = {"turn": 0.4, "shoulder": -0.3, "elbow": 0.5}
    observation, _ = env.reset(seed=1, options={"goal": goal})
    for _ in range(env.STEPS):
        observation, reward, terminated, _, info = env.step(towards(env, observation))
        assert not terminated, info["fault"]
    assert info["is_success"]
    assert reward > 0.9
    for name, place in goal.items():
        assert env.machine.data.joint(name).qpos[0] == pytest.approx(place, abs=1e-3)


def test_the_place_of_a_site_is_that_of_mujoco_whichever_machine_shares_its_data():
    vector = ServoVectorEnv(RobotEnv, 3, threads=1, site="tool")
    vector.reset(seed=4)
    for _ in range(30):
        *_, infos = vector.step(0.5 * vector.action_space.sample())
    for i, env in enumerate(vector.envs):
        with env.machine.turn:
            data = mujoco.MjData(env.machine.model)
            data.qpos[:] = env.machine.data.qpos
        mujoco.mj_kinematics(env.machine.model, data)
        found = [infos[axis][i] for axis in "xyz"]
        assert found == pytest.approx(data.site("tool").xpos, abs=1e-9)


def test_a_robot_from_outside_by_its_path_and_its_sites_or_joints():
    env = gym.make("servogym.envs:servogym/Robot-v0", mjcf=str(REACHER), goals=["joint1"])
    observation, _ = env.reset(seed=0)
    assert env.action_space.shape == (2,)
    for _ in range(200):
        observation, *_, info = env.step(towards(env.unwrapped, observation))
    assert info["distance"] < 0.02


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"drives": ["elbw"]}, "there is no actuator or joint 'elbw'"),
        ({"goals": ["elbw"]}, "goals: there is no drive 'elbw': did you mean elbow"),
        ({"site": "tol"}, "site = 'tol': did you mean tool"),
        ({"mjcf": "nothing.xml"}, "there is no MJCF file nothing.xml"),
        ({"span": -1}, "span = -1 is out of range"),
        ({"mjcf": "<mujoco/>"}, "0 joints would get one"),
    ],
)
def test_what_does_not_fit_is_refused_in_words(arguments, says):
    with pytest.raises(ValueError, match=says):
        RobotEnv(**arguments)


def test_an_option_that_is_none_is_refused():
    env = RobotEnv()
    for options, says in (
        ({"goal": {"elbw": 0.1}}, "did you mean elbow"),
        ({"goal": {"elbow": 9.0}}, "out of range"),
        ({"start": 3}, "give values by name"),
        ({"gaol": {}}, "did you mean goal"),
    ):
        with pytest.raises(ValueError, match=says):
            env.reset(options=options)


def test_the_contact_that_stops_a_joint_is_named():
    machine = Machine.from_mjcf(WALLED, {"swing": "generic"})
    commission_joint(machine, "swing")
    master = Master(MachinePort(machine), "swing")
    master.enable()
    master.home()
    master.move_to(-0.2)
    with pytest.raises(ServoError, match="beam touches wall"):
        master.move_to(-1.6, timeout=5.0)


@pytest.mark.parametrize(
    ("joint", "says"),
    [
        ('damping="2e4"', "its damping of 20000 takes .* Nm, the drive gives .* Nm"),
        ('stiffness="3e4"', "its spring takes .* Nm, the drive gives"),
        ('range="-1 1" solreflimit="-1e5 -1e3"', "its limit takes .* Nm, the drive gives"),
    ],
)
def test_a_force_that_stops_a_joint_is_named(joint, says):
    machine = Machine.from_mjcf(HELD.format(joint), {"swing": "generic"})
    commission_joint(machine, "swing", tuned=False)  # else its profile suits the damping
    machine.drives["swing"].write("max_position_limit", 3_000_000)
    master = Master(MachinePort(machine), "swing")
    master.enable()
    master.home()
    with pytest.raises(ServoError, match=says):
        master.move_to(2.5, timeout=5.0)


@pytest.mark.parametrize(
    ("equality", "says"),
    [
        ('<weld body1="beam"/>', "the weld constraint of beam and world takes .* the drive gives"),
        ('<weld name="clamp" body1="beam"/>', "the weld constraint 'clamp' takes"),
        ('<joint joint1="swing"/>', "the joint constraint of swing takes"),
    ],
)
def test_an_equality_that_holds_a_joint_is_named(equality, says):
    text = HELD.format("").replace("</worldbody>", f"</worldbody><equality>{equality}</equality>")
    machine = Machine.from_mjcf(text, {"swing": "generic"})
    commission_joint(machine, "swing", tuned=False)
    master = Master(MachinePort(machine), "swing")
    master.enable()
    master.home()
    with pytest.raises(ServoError, match=says):
        master.move_to(0.5, timeout=5.0)


def test_a_robot_that_has_fallen_names_the_floor():
    machine = Machine.from_mjcf(FALLING, {"swing": "generic"})
    machine.step(2000)
    port = MachinePort(machine)
    assert port.obstacles("swing") == ["trunk touches floor (the base is free)"]


def test_a_gear_that_scales_a_control_is_no_reduction():
    text = """<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
      <actuator><motor joint="j" gear="0.5" {}/></actuator></mujoco>"""
    for range_, gear in (('ctrlrange="-1 1"', 100.0), ("", 0.5)):
        machine = Machine.from_mjcf(text.format(range_), {"j": "generic"})
        assert machine.couplings["gear"][0] == gear


def test_a_baseline_brings_all_joints_to_their_goals_and_knows_no_site():
    env = RobotEnv()
    policy = make("proportional", env)
    observation, info = env.reset(seed=3)
    policy.reset(observation, info)
    for _ in range(env.STEPS):
        observation, *_, info = env.step(policy.act(observation))
    assert info["is_success"]
    with pytest.raises(ValueError, match="for servogym/Robot-v0 choose of hold, random"):
        make("proportional", RobotEnv(site="tool"))
