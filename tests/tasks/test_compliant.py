"""servogym/CompliantAxis-v0: checker, faces, and an input shaper that lets the load rest."""

import math

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import servogym.envs
from servogym.drive.kernel.words import Mode
from servogym.drive.model.model import load, model_names
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.plants.linear_axis import LinearAxisParameters
from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.training.policies.profiles import Bounds, shaped, trapezoid

STEPS = CompliantAxisEnv.STEPS
FAR = {"start": 0.1, "goal": 0.4}
TERMS = ("reward_near", "reward_settled", "reward_gentle", "cost")
assert servogym.envs


@pytest.fixture
def env():
    env = CompliantAxisEnv()
    yield env
    env.close()


def direct(env):
    """Trapezoidal velocity."""
    return trapezoid(FAR["goal"] - FAR["start"], Bounds(0.8, 10.0, math.inf))


def gentle(env):
    """The same through a shaper that knows the load as it really is."""
    mass = env.machine.model.body("payload").mass[0]
    joint = env.machine.model.joint("load")
    stiffness, damping = joint.stiffness[0], joint.damping[0]
    ratio = damping / (2 * math.sqrt(stiffness * mass))
    return shaped(direct(env), math.sqrt(stiffness / mass), ratio)


def move(env, path, seed=0):
    """-> return, time from which on the load is settled (s), largest energy (J)."""
    env.reset(seed=seed, options=FAR)
    times = np.arange(STEPS + 1) * env.step_time
    places = np.zeros(STEPS + 1) if path is None else path(env)(times)
    speeds = np.diff(places) / env.episode._way
    total, restless, energy = 0.0, 0, 0.0
    for step, speed in enumerate(speeds):
        observation, reward, terminated, _, info = env.step(np.array([speed, 0.0]))
        assert not terminated, info["fault"]
        assert env.observation_space.contains(observation)
        assert all(0.0 <= info[term] <= 1.0 for term in TERMS)
        total += reward
        energy = max(energy, info["energy"])
        if not info["is_success"]:
            restless = step + 1
    return total, restless * env.step_time, energy


@pytest.mark.parametrize("model", model_names())
def test_every_drive_model_does_the_task_or_is_refused_by_the_mode_it_lacks(model):
    if Mode.CYCLIC_SYNC_POSITION not in load(model).modes:
        with pytest.raises(ValueError, match="has no mode cyclic_sync_position"):
            CompliantAxisEnv(model)
        return
    env = CompliantAxisEnv(model, randomise={})
    check_env(env, skip_render_check=True)
    end = STEPS * env.step_time
    held, _, calm = move(env, None)
    plain, late, shake = move(env, direct)
    swinging = env.unwrapped.info()["energy"]
    smooth, _, little = move(env, gentle)
    assert calm < 1e-6
    assert little < shake
    assert late == pytest.approx(end), "after a direct move it swings on"
    assert env.unwrapped.info()["energy"] < 0.01 * swinging
    assert smooth > plain + 0.1 * STEPS > held + 0.2 * STEPS


def test_the_shaper_also_serves_loads_drawn_at_random(env):
    ends = {True: [], False: []}
    for seed in range(5):
        ends[False].append(move(env, direct, seed)[1])
        ends[True].append(move(env, gentle, seed)[1])
    assert np.median(ends[True]) < 0.5 * np.median(ends[False]), ends


def test_the_load_is_judged_and_not_the_carriage(env):
    env.reset(seed=1, options={"start": 0.2, "goal": 0.2})
    env.machine.data.qpos[1] = 2e-3
    seen = [env.step(np.zeros(2)) for _ in range(100)]
    distances = [info["distance"] for *_, info in seen]
    assert max(distances) > 1e-3
    assert min(distances) < -1e-3
    settled = np.mean([info["reward_settled"] for *_, info in seen])
    assert settled < 0.1
    assert np.abs([observation[1] - (0.4 * 2 - 1) for observation, *_ in seen]).max() < 0.01


def test_without_the_load_sensor_the_agent_sees_the_drive_only():
    seen = {}
    for sensor in (True, False):
        env = CompliantAxisEnv(load_sensor=sensor)
        env.reset(seed=1)
        env.machine.data.qpos[1] = 2e-3
        seen[sensor] = np.array([env.step(np.zeros(2))[0] for _ in range(20)])
    of_the_drive = [0, 1, 2, 3, 4, 5, 8]
    np.testing.assert_array_equal(seen[True][:, of_the_drive], seen[False][:, of_the_drive])
    assert np.abs(seen[True][:, 6:8]).max(axis=0).min() > 0.1
    assert not seen[False][:, 6:8].any()


def test_torque_feed_forward_moves_it_within_its_range():
    def deflection(torque_range, action):
        env = CompliantAxisEnv(torque_range=torque_range)
        env.reset(seed=1)
        env.step(np.array([0.0, action]))
        return env.episode.deflection

    still = deflection(0.1, 0.0)
    assert abs(deflection(0.2, 1.0) - still) > 1.5 * abs(deflection(0.1, 1.0) - still) > 1e-6
    assert deflection(0.0, 1.0) == still


def test_history_and_previous_action_are_shown():
    env = CompliantAxisEnv(history=4, previous_action=True)
    env.reset(seed=1)
    observation, *_ = env.step(np.array([0.25, -0.5]))
    assert observation.shape == (4 * 9 + 2,)
    assert observation[-2:] == pytest.approx([0.25, -0.5])


def test_on_an_inclined_axis_the_sag_is_no_vibration():
    p = LinearAxisParameters(payload=5.0, stiffness=2e4, structural_damping=200.0, inclination=30.0)
    env = CompliantAxisEnv(parameters=p, randomise={})
    env.reset(seed=1, options={"start": 0.2})
    for _ in range(200):
        *_, info = env.step(np.zeros(2))
    assert info["deflection"] == pytest.approx(-5 * 9.81 * 0.5 / 2e4, rel=0.02)
    assert info["energy"] < 1e-6


def test_with_raw_controlwords_it_is_enabled_and_moved():
    env = CompliantAxisEnv(action="pdo")
    check_env(env, skip_render_check=True)
    env.reset(seed=1, options={"start": 0.2, "goal": 0.25})
    for step in range(300):
        word = (0x06, 0x07, 0x0F)[min(step // 3, 2)]
        bits = [1.0 if word >> bit & 1 else -1.0 for bit in range(9)]
        speed = 0.02 if 20 <= step < 20 + 250 else 0.0  # 0.2 mm a step
        *_, terminated, _, info = env.step(np.array([speed, 0.0, *bits, -0.5], np.float32))
        assert not terminated
    assert info["state"] == "OPERATION_ENABLED"
    assert abs(info["distance"]) < 1e-3


def test_a_fault_or_failing_physics_terminates_with_its_code(env):
    faulty = CompliantAxisEnv(faults={"encoder_loss": 1.0})
    faulty.reset(seed=1)
    *_, terminated, _, info = faulty.step(np.zeros(2))
    assert terminated
    assert info["fault"].startswith("7305h")
    env.reset(seed=1)
    env.machine.data.qvel[:] = math.nan
    observation, reward, terminated, _, info = env.step(np.zeros(2))
    assert terminated
    assert info["fault"].startswith("7305h")
    assert env.observation_space.contains(observation)
    assert 0.0 <= reward <= 1.0
    assert np.isfinite(info["energy"])


def test_payload_stiffness_and_damping_are_drawn_and_set(env):
    nominal = env.datasheet
    values = [env.reset(seed=seed)[1]["parameters"] for seed in range(4)]
    assert len({v["stiffness"] for v in values}) == 4
    joint = env.machine.model.joint("load")
    assert joint.stiffness[0] == pytest.approx(values[-1]["stiffness"] * nominal.stiffness)
    share = values[-1]["structural_damping"]
    assert joint.damping[0] == pytest.approx(share * nominal.structural_damping)
    assert env.machine.model.joint("x").damping[0] == nominal.viscous_friction
    assert env.machine.model.body("payload").mass[0] == pytest.approx(values[-1]["payload"])
    rigid = LinearAxisParameters(payload=5.0, stiffness=2e4)
    assert "structural_damping" not in CompliantAxisEnv(parameters=rigid).reset()[1]["parameters"]
    with pytest.raises(ValueError, match=r"randomise\['structural_damping'\]"):
        CompliantAxisEnv(parameters=rigid, randomise={"structural_damping": 1.0})


def test_the_vector_is_bit_for_bit_the_environments_one_by_one():
    peers = gym.vector.SyncVectorEnv(
        [lambda: gym.wrappers.TimeLimit(CompliantAxisEnv(), 25) for _ in range(3)]
    )
    vector = ServoVectorEnv(CompliantAxisEnv, 3, threads=2, max_episode_steps=25)
    np.testing.assert_array_equal(peers.reset(seed=7)[0], vector.reset(seed=7)[0])
    generator = np.random.default_rng(1)
    for _ in range(60):
        action = generator.uniform(-0.3, 0.3, (3, 2)).astype(np.float32)
        for a, b in zip(peers.step(action)[:4], vector.step(action)[:4], strict=True):
            np.testing.assert_array_equal(a, b)
    peers.close()
    vector.close()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"parameters": LinearAxisParameters()}, "stiffness = 0.0 N/m"),
        ({"parameters": "toothed_belt"}, "this task needs a load on a spring"),
        ({"torque_range": 2.0}, r"torque_range = 2.0 is out of range 0..1"),
        ({"tolerance": "small"}, "tolerance"),
        ({"randomise": {"stiffness": (2.0, 1.0)}}, "stiffness"),
        ({"following_error_window": 0.0}, "following_error_window"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        CompliantAxisEnv(**arguments)


def test_wrong_options_are_named(env):
    for name in FAR:
        with pytest.raises(ValueError, match=name):
            env.reset(options={name: 7.0})
