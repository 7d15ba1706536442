"""servogym/Robot-v0: any MJCF, goals for joints or a site; and what is in the way of a joint."""

from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from servogym.drive.master import Master, ServoError
from servogym.envs import Machine, commission_joint
from servogym.envs.masters.port import MachinePort
from servogym.envs.tasks.robot import RobotEnv
from servogym.envs.vector_env import ServoVectorEnv

REACHER = Path(gym.__file__).parent / "envs/mujoco/assets/reacher.xml"
WALLED = """<mujoco><worldbody>
  <geom name="wall" type="box" pos="0.5 0 0" size="0.02 0.3 0.3"/>
  <body name="arm"><joint name="swing" axis="0 0 1" range="-170 170"/>
    <geom name="beam" type="capsule" fromto="0 0.05 0 0 0.6 0" size="0.02" mass="2"/></body>
  </worldbody></mujoco>"""


def towards(env, observation):
    """Each joint to its goal, at a speed in proportion."""
    axes = env.seen(observation).axes
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


def test_a_gear_that_scales_a_control_is_no_reduction():
    text = """<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>
      <actuator><motor joint="j" gear="0.5" {}/></actuator></mujoco>"""
    for range_, gear in (('ctrlrange="-1 1"', 100.0), ("", 0.5)):
        machine = Machine.from_mjcf(text.format(range_), {"j": "generic"})
        assert machine.couplings["gear"][0] == gear
