"""servogym/LinearAxis-v0: checkers, determinism, faults, pictures."""

import multiprocessing
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import servogym.envs
from servogym.drive.kernel.words import Mode
from servogym.drive.model.model import load, model_names
from servogym.envs.tasks.positioning import LinearAxisEnv

ID = "servogym/LinearAxis-v0"
assert servogym.envs


@pytest.fixture
def env():
    env = gym.make("servogym.envs:" + ID, drive="generic")
    yield env
    env.close()


def towards_goal(observation):
    """A careful proportional policy: set-point speed from the distance to the goal."""
    return np.clip(np.array([observation[0] * 4], np.float32), -0.1, 0.1)


def rollout(seed, steps=40):
    env = gym.make(ID)
    observation, _ = env.reset(seed=seed)
    seen = [observation]
    for _ in range(steps):
        observation, reward, *_ = env.step(towards_goal(observation))
        seen.append(np.append(observation, reward))
    return b"".join(np.asarray(s).tobytes() for s in seen)


def test_gymnasium_checker_is_content(env):
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("model", model_names())
def test_every_drive_model_does_the_task_or_is_refused_by_the_mode_it_lacks(model):
    if Mode.CYCLIC_SYNC_POSITION not in load(model).modes:
        with pytest.raises(ValueError, match="has no mode cyclic_sync_position"):
            LinearAxisEnv(drive=model)
        return
    env = LinearAxisEnv(drive=model)
    check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=3, options={"start": 0.1, "goal": 0.13})
    for _ in range(400):
        observation, *_, terminated, _, info = env.step(towards_goal(observation))
        assert not terminated
    assert info["is_success"]


def test_stable_baselines_checker_is_content(env):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(env.unwrapped, warn=True, skip_render_check=True)


def test_a_declared_fault_is_injected_from_the_seed_and_told():
    def episode(seed):
        env = LinearAxisEnv(faults={"encoder_loss": 0.05, "short_circuit": 0.0})
        env.reset(seed=seed)
        for step in range(200):
            *_, terminated, _, info = env.step(np.zeros(1))
            if terminated:
                return step, info["injected"], info["fault"]
        return None

    step, injected, fault = episode(5)
    assert injected == ("encoder_loss",)
    assert fault.startswith("7305h")
    assert episode(5)[0] == step
    assert episode(6)[0] != step
    with pytest.raises(ValueError, match="encoder_loss"):
        LinearAxisEnv(faults={"gremlin": 0.1})
    with pytest.raises(ValueError, match=r"range 0..1"):
        LinearAxisEnv(faults={"encoder_loss": 2})


def test_a_careful_policy_reaches_the_goal(env):
    observation, info = env.reset(seed=3, options={"start": 0.1, "goal": 0.16})
    assert info["goal"] == 0.16
    for _ in range(200):
        observation, reward, terminated, truncated, info = env.step(towards_goal(observation))
        assert 0.0 <= reward <= 1.0
        assert env.observation_space.contains(observation)
    assert truncated
    assert not terminated
    assert info["is_success"]
    assert reward > 0.99


def test_a_set_point_too_steep_ends_in_the_drives_own_fault(env):
    env.reset(seed=1, options={"start": 0.25})
    keys = set()
    for step in range(200):
        direction = 1.0 if step // 5 % 2 else -1.0
        *_, terminated, _, info = env.step(np.array([direction], np.float32))
        keys.add(tuple(info))
        if terminated:
            break
    assert terminated
    assert len(keys) == 1
    assert info["fault"] == "8611h following error"
    assert info["state"] in ("FAULT", "FAULT_REACTION_ACTIVE")


def test_physics_that_fails_ends_the_episode_with_a_named_fault(env):
    env.reset(seed=1)
    env.unwrapped.machine.data.qvel[0] = float("nan")
    observation, reward, terminated, _, info = env.step(np.zeros(1, np.float32))
    assert terminated
    assert info["fault"].startswith("7305h")
    assert np.isfinite(observation).all()
    assert np.isfinite(reward)
    env.reset(seed=1)
    *_, terminated, _, info = env.step(np.zeros(1, np.float32))
    assert not terminated
    assert info["fault"] == ""


def test_one_seed_one_rollout_also_in_another_process():
    assert rollout(7) == rollout(7)
    assert rollout(7) != rollout(8)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(rollout, (7,)) == rollout(7)


def test_vector_environments():
    for kind in (gym.vector.SyncVectorEnv, gym.vector.AsyncVectorEnv):
        envs = kind([lambda: gym.make(ID)] * 2)
        first, _ = envs.reset(seed=5)
        envs.step(np.zeros((2, 1), np.float32))
        assert first.shape == (2, 7)
        envs.close()


def test_the_spec_can_be_pickled(env):
    again = gym.make(pickle.loads(pickle.dumps(env.spec)))
    assert again.reset(seed=2)[0] == pytest.approx(env.reset(seed=2)[0], abs=0)


def test_a_pickled_environment_goes_on_bit_for_bit():
    ranges = {"payload": (1.0, 9.0), "friction": (0.5, 2.0), "encoder_noise": 1e-6, "delay": (0, 9)}
    env = LinearAxisEnv(randomise=ranges, history=3, faults={"encoder_loss": 0.01})
    env.reset(seed=11)
    generator = np.random.default_rng(2)
    actions = generator.uniform(-0.2, 0.2, (60, 1)).astype(np.float32)
    for action in actions[:30]:
        env.step(action)
    again = pickle.loads(pickle.dumps(env))
    for action in actions[30:]:
        one, other = env.step(action), again.step(action)
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1:] == other[1:]
    np.testing.assert_array_equal(env.reset()[0], again.reset()[0])


@pytest.mark.parametrize("action", [[2.0], [float("nan")], [0.0, 0.0], 0.0, [[0.0]]])
def test_a_wrong_action_is_an_error_that_names_the_fix(action, env):
    env.reset(seed=0)
    with pytest.raises(ValueError, match="clip it"):
        env.unwrapped.step(np.array(action))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step_time": 1.1e-3}, "whole number"),
        ({"step_time": 0.0}, "step_time = 0.0"),
        ({"step_time": float("nan")}, "step_time = nan"),
        ({"history": "two"}, "history = .two."),
        ({"step_time": 0.2555}, "60C2h"),
        ({"payload": -1.0}, "payload = -1.0"),
        ({"mode": "pp"}, "mode = 'pp': choose one of csp, csv, cst"),
        ({"tolerance": float("nan")}, "tolerance"),
        ({"render_mode": "ascii"}, "render_mode"),
        ({"drive": "acme"}, "unknown drive model"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        LinearAxisEnv(**arguments)


def test_in_csv_the_action_is_the_velocity_and_a_limit_ahead_brakes():
    env = LinearAxisEnv(mode="csv")
    env.reset(seed=1, options={"start": 0.1})
    for _ in range(20):
        observation, *_ = env.step(np.array([0.2], np.float32))
        assert observation[5] == 0.0
    assert env.machine.data.qvel[0] == pytest.approx(0.2 * 2.0, rel=0.02)  # 607Fh is 2 m/s
    for _ in range(400):
        *_, terminated, _, _ = env.step(np.array([0.2], np.float32))
        assert not terminated
    assert 0.49 < env.machine.data.qpos[0] <= 0.501


def test_in_cst_the_action_is_the_torque_and_the_drive_stands_before_its_software_limit():
    env = LinearAxisEnv(mode="cst", payload=5.0)
    env.reset(seed=1, options={"start": 0.1})
    for _ in range(8):
        observation, *_ = env.step(np.array([0.2], np.float32))
    assert observation[4] == pytest.approx(0.2, abs=1e-3)
    gear = 2 * np.pi / 0.06
    mass, force = 6.5 + 6e-5 * gear**2, 0.2 * 3 * 1.27 * gear  # kg, N
    # of force less 12 N of Coulomb and 20 N·s/m of viscous friction
    speed = (force - 12.0) / 20.0 * (1.0 - np.exp(-20.0 / mass * 8 * env.step_time))
    assert env.machine.data.qvel[0] == pytest.approx(speed, rel=0.05)
    places = []
    for _ in range(400):
        observation, reward, *_ = env.step(np.array([1.0], np.float32))
        places.append(env.machine.data.qpos[0])
        assert env.observation_space.contains(observation)
        assert np.isfinite(reward)
    assert 0.47 < max(places) <= 0.5  # 607Dh
    assert np.ptp(places[-50:]) < 1e-3


def test_a_drive_without_the_mode_is_refused_by_its_name():
    with pytest.raises(ValueError, match="'kollmorgen_akd' has no mode cyclic_sync_torque"):
        LinearAxisEnv("kollmorgen_akd", mode="cst")


def test_an_environment_in_torque_mode_goes_on_from_a_pickle():
    env = LinearAxisEnv(mode="cst")
    env.reset(seed=1)
    env.step(np.array([0.1], np.float32))
    again = pickle.loads(pickle.dumps(env))
    one, other = env.step(np.array([0.1], np.float32)), again.step(np.array([0.1], np.float32))
    np.testing.assert_array_equal(one[0], other[0])


def test_wrong_options_are_named(env):
    with pytest.raises(ValueError, match="goal"):
        env.reset(options={"goal": 7.0})


def test_a_picture_with_the_goal_in_it():
    env = gym.make(ID, render_mode="rgb_array")
    try:
        env.reset(seed=1, options={"start": 0.1, "goal": 0.4})
        picture = env.render()
    except Exception as error:
        pytest.skip(f"no GL here: {type(error).__name__}: {error}")
    assert picture.shape == (540, 960, 3)
    assert picture.std() > 10
    env.reset(seed=1, options={"start": 0.1, "goal": 0.2})
    assert (env.render() != picture).any(), "the ghost has moved"
    env.close()
    env.close()
