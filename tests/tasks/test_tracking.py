"""servogym/LinearAxisTracking-v0: checker, faces, feed-forward against the bare cascade."""

import math
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import servogym.envs
from servogym.drive.kernel.modes.csp import SMOOTHING
from servogym.drive.kernel.words import Mode
from servogym.drive.model.model import load, model_names
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.plants.linear_axis import LinearAxisParameters
from servogym.envs.tasks.references import REFERENCES
from servogym.envs.tasks.tracking import STEPS, LinearAxisTrackingEnv

ID = "servogym/LinearAxisTracking-v0"
TORQUE = 3 * 1.27 * 2 * math.pi / 0.06  # N at the belt for the maximum torque
HEAVY = {"payload": 10.0, "friction": 2.0}
assert servogym.envs


@pytest.fixture
def env():
    env = LinearAxisTrackingEnv()
    yield env
    env.close()


def hold(env):
    return np.zeros(2)


def feed_forward(env):
    """The force that the motion takes, less what the drive feeds forward for the nominal payload.

    The drive's own acceleration is smoothed (`servogym.drive.kernel.modes.csp`), so it comes late.
    """
    position, velocity, acceleration = (
        env.episode[name][: STEPS + 1] for name in ("_position", "_velocity", "_acceleration")
    )
    nominal, real = LinearAxisParameters(), env.parameters
    carriage = env.machine.model.dof_armature[0] + 1.5
    slope = np.diff(position, prepend=position[0]) / env.step_time
    own = [0.0]
    for rate in np.diff(slope) / env.step_time:
        own.append(own[-1] + SMOOTHING * (rate - own[-1]))
    middle = (velocity[1:] + velocity[:-1]) / 2
    force = (carriage + real["payload"]) * (acceleration[1:] + acceleration[:-1]) / 2
    force -= (carriage + nominal.payload) * np.array(own[1:])
    friction = nominal.coulomb_friction * np.tanh(middle / 0.02)
    force += real["friction"] * (friction + nominal.viscous_friction * middle)
    return np.clip([0.0, force[min(env.episode._now, STEPS - 1)] / TORQUE], -1.0, 1.0)


def run(env, policy, steps=STEPS, **reset):
    """-> return, info of the last step."""
    env.reset(**reset)
    total = 0.0
    for _ in range(steps):
        observation, reward, terminated, _, info = env.step(policy(env))
        assert not terminated, info["fault"]
        assert env.observation_space.contains(observation)
        for term in ("reward_close", "reward_smooth", "cost"):
            assert 0.0 <= info[term] <= 1.0
        total += reward
    return total, info


@pytest.mark.parametrize("model", model_names())
def test_every_drive_model_does_the_task_or_is_refused_by_the_mode_it_lacks(model):
    if Mode.CYCLIC_SYNC_POSITION not in load(model).modes:
        with pytest.raises(ValueError, match="has no mode cyclic_sync_position"):
            LinearAxisTrackingEnv(model)
        return
    env = LinearAxisTrackingEnv(model)
    check_env(env, skip_render_check=True)
    for name in REFERENCES:
        total, info = run(env, hold, seed=2, options={"reference": name})
        assert total > 0.6 * STEPS
        assert abs(info["error"]) < 20e-6, "it has come to rest"


def test_an_ideal_feed_forward_halves_the_error_of_the_bare_cascade():
    for kind in ("pick_and_place", "way_points"):
        env = LinearAxisTrackingEnv(reference=kind, randomise=HEAVY)
        lost, errors = {}, {}
        for policy in (hold, feed_forward):
            runs = [run(env, policy, seed=seed) for seed in range(3)]
            lost[policy] = np.mean([STEPS - total for total, _ in runs])
            errors[policy] = np.mean([info["rms_error"] for _, info in runs])
        assert errors[feed_forward] < 0.5 * errors[hold], errors
        assert lost[feed_forward] < 0.7 * lost[hold], lost


def test_a_correction_moves_the_axis_by_that_much(env):
    _, info = run(env, lambda env: np.array([0.5, 0.0]), options={"way_points": [0.3]})
    assert info["error"] == pytest.approx(-0.5e-3, abs=10e-6)
    assert info["reward_close"] == pytest.approx(1 / 51, rel=0.05), "half at 10 µm"
    assert not info["is_success"]


def test_rewards_tell_close_from_far_and_smooth_from_rough(env):
    def rough(env):
        return np.array([0.0, 0.2 if env._steps % 2 else -0.2])

    still = {"seed": 4, "options": {"way_points": []}}
    _, calm = run(env, hold, 50, **still)
    _, shaken = run(env, rough, 50, **still)
    assert 0.8 * calm["reward_close"] + 0.2 * calm["reward_smooth"] == pytest.approx(1.0, abs=0.01)
    assert calm["is_success"]
    assert shaken["reward_smooth"] < 0.2
    assert shaken["reward_close"] < calm["reward_close"]


def test_the_preview_is_the_reference_to_come(env):
    observation, _ = env.reset(seed=3, options={"reference": "sine"})
    for _ in range(60):
        observation, *_ = env.step(hold(env))
    position, now = env.episode._position, 60
    assert env.episode._now == now
    expected = [
        (position[now + n] - position[now]) / (2.0 * n * env.step_time) for n in (2, 4, 6, 8)
    ]
    assert observation[7:] == pytest.approx(expected, abs=1e-6)
    assert np.abs(observation[7:]).max() > 1e-3
    assert observation[2] == pytest.approx(env.episode._velocity[now] / 2.0, abs=1e-6)


def test_with_raw_controlwords_the_reference_waits_for_the_drive():
    env = LinearAxisTrackingEnv(action="pdo", reference="s_curve")
    check_env(env, skip_render_check=True)
    env.reset(seed=1)

    def control(word):
        bits = [1.0 if word >> bit & 1 else -1.0 for bit in range(9)]
        return env.step(np.array([0.0, 0.0, *bits, -0.5], np.float32))

    for word in (0x00, 0x06, 0x06, 0x07, 0x07):
        _, reward, *_ = control(word)
        assert env.episode._now == 0
        assert reward == 0.0
    for _ in range(STEPS + 5):
        _, reward, terminated, _, info = control(0x0F)
        assert not terminated
    assert env.episode._now == STEPS
    assert info["state"] == "OPERATION_ENABLED"
    assert reward > 0.9
    assert info["rms_error"] < 50e-6


def test_kinds_are_drawn_and_parameters_told(env):
    seen = [env.reset(seed=seed)[1]["parameters"] for seed in range(5)]
    assert all(set(p) == {"payload", "friction"} for p in seen)
    assert len({p["payload"] for p in seen}) == 5
    shapes = {env.reset(seed=seed) and env.episode._position.tobytes() for seed in range(5)}
    assert len(shapes) == 5
    assert LinearAxisTrackingEnv(randomise={}).reset(seed=1)[1]["parameters"] == {}


def test_a_fault_terminates_with_its_code():
    env = LinearAxisTrackingEnv(faults={"encoder_loss": 1.0})
    env.reset(seed=1)
    _, reward, terminated, _, info = env.step(np.zeros(2))
    assert terminated
    assert reward == 0.0
    assert info["fault"].startswith("7305h")


def test_the_vector_is_bit_for_bit_the_environments_one_by_one():
    peers = gym.vector.SyncVectorEnv(
        [lambda: gym.wrappers.TimeLimit(LinearAxisTrackingEnv(), 25) for _ in range(3)]
    )
    vector = ServoVectorEnv(LinearAxisTrackingEnv, 3, threads=2, max_episode_steps=25)
    np.testing.assert_array_equal(peers.reset(seed=7)[0], vector.reset(seed=7)[0])
    generator = np.random.default_rng(1)
    for _ in range(60):
        action = generator.uniform(-0.5, 0.5, (3, 2)).astype(np.float32)
        for a, b in zip(peers.step(action)[:4], vector.step(action)[:4], strict=True):
            np.testing.assert_array_equal(a, b)
    peers.close()
    vector.close()


def test_a_pickled_environment_goes_on_bit_for_bit(env):
    env.reset(seed=5)
    actions = np.random.default_rng(2).uniform(-0.3, 0.3, (60, 2))
    for action in actions[:30]:
        env.step(action)
    again = pickle.loads(pickle.dumps(env))
    for action in actions[30:]:
        one, other = env.step(action), again.step(action)
        assert one[0].tobytes() == other[0].tobytes()
        assert one[1:] == other[1:]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"reference": "spiral"}, "reference = 'spiral': choose one of step, s_curve"),
        ({"correction": 1.0}, r"correction = 1.0 is out of range .* m"),
        ({"tolerance": 0}, "tolerance"),
        ({"payload": -1.0}, "payload = -1.0"),
        ({"randomise": {"stiffness": 2.0}}, "no springs"),
        ({"following_error_window": math.nan}, "following_error_window"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        LinearAxisTrackingEnv(**arguments)


@pytest.mark.parametrize("options", [{"start": 7}, {"reference": "spiral"}, {"way_points": 0.9}])
def test_wrong_options_are_named(options, env):
    with pytest.raises(ValueError, match=next(iter(options))):
        env.reset(options=options)
