"""servogym/Homing-v0: an agent and the built-in methods look for the same reference."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

import servogym.envs
from servogym.drive.kernel.words import ENABLED, TO_ENABLED, Mode, State, state_of
from servogym.drive.model.model import load, model_names
from servogym.envs.engine.tick import HOME
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.exchange.fields import width
from servogym.envs.masters.homing_figures import true_home
from servogym.envs.tasks.homing import REFERENCES, HomingEnv
from servogym.training.policies import make

assert servogym.envs

CAPABLE = [
    name for name in model_names() if {Mode.PROFILE_VELOCITY, Mode.HOMING} <= set(load(name).modes)
]


def play(env, observation):
    """The scripted search -> sum of the rewards, the last info."""
    policy, total, way = make("search", env), 0.0, 0.0
    policy.reset(observation, {})
    for _ in range(2000):
        observation, reward, terminated, _, info = env.step(policy.act(observation))
        assert env.observation_space.contains(observation)
        assert 0.0 <= reward <= 1.0
        assert all(0.0 <= info[name] <= 1.0 for name in info if name.startswith("reward_"))
        total += reward
        way += info["reward_search"]
        if terminated:
            break
    assert way == pytest.approx(1.0, abs=0.01), "all of it, once"
    return total, info


@pytest.mark.parametrize("model", model_names())
def test_every_drive_model_does_the_task_or_is_refused_by_the_mode_it_lacks(model):
    if model not in CAPABLE:
        with pytest.raises(ValueError, match="has no mode profile_velocity"):
            HomingEnv(drive=model)
        return
    env = HomingEnv(drive=model)
    check_env(env, skip_render_check=True)
    csv = Mode.CYCLIC_SYNC_VELOCITY in load(model).modes
    own = Mode.CYCLIC_SYNC_VELOCITY if csv else Mode.PROFILE_VELOCITY
    assert env.MODES[0] == own
    for start in (0.05, 0.45):  # both sides of the switch
        observation, _ = env.reset(seed=1, options={"start": start})
        _, info = play(env, observation)
        assert info["is_success"], info
        assert abs(info["error"]) < 50e-6


@pytest.mark.parametrize("reference", REFERENCES)
def test_a_scripted_search_attains_each_reference_and_beats_holding_still(reference):
    env = HomingEnv(reference=reference)
    observation, _ = env.reset(seed=3, options={"start": 0.2})
    total, info = play(env, observation)
    assert info["is_success"]
    assert total > 0.6
    env.reset(seed=3, options={"start": 0.2})
    still = sum(env.step(np.array([0, 1, -1], np.float32))[1] for _ in range(200))
    assert still == 0.0


def test_an_agent_may_be_faster_than_the_method_of_the_drive_but_not_as_exact():
    env = HomingEnv()
    observation, _ = env.reset(seed=1, options={"start": 0.45})
    method = env.built_in(23)
    _, info = play(env, observation)
    assert method.attained
    assert info["time"] < 0.5 * method.time
    assert info["greatest_torque"] > 2 * method.greatest_torque
    assert abs(method.error) < 5e-6 < abs(info["error"])


@pytest.mark.parametrize("method", [1, 2, 7, 11, 17, 18, 23, 24, 26, 27, 29, 33, 34])
def test_a_built_in_method_finds_the_true_home(method):
    env = HomingEnv()
    env.reset(seed=4, options={"start": 0.33})
    figures = env.built_in(method)
    assert figures.attained
    assert abs(figures.error) < 5e-6, true_home(env.machine, method, 0.33)
    assert figures.impact_energy == 0.0


def test_a_method_on_a_stop_brings_the_energy_of_its_speed_into_it():
    env = HomingEnv(reference="stop")
    env.reset(seed=4, options={"start": 0.01})
    mass = 6.5 + float(env.machine.model.dof_armature[0])
    for speed in (0.01, 0.05):
        figures = env.built_in(-17, {"speed_during_search_for_zero": round(speed * 1e6)})
        assert figures.attained
        assert abs(figures.error) < 20e-6
        assert figures.impact_energy == pytest.approx(0.5 * mass * speed**2, rel=0.05)


def test_a_built_in_run_leaves_the_episode_as_it_was():
    def episode(compare):
        env = HomingEnv()
        env.reset(seed=9)
        action = np.array([0.3, -0.5, -1], np.float32)
        for _ in range(20):
            observation = env.step(action)[0]
        if compare:
            env.built_in(17)
        return observation.tobytes() + env.step(action)[0].tobytes()

    assert episode(True) == episode(False)


@pytest.mark.parametrize("method", [35, 5000, 8])
def test_a_method_that_is_no_search_of_the_drive_is_refused(method):
    env = HomingEnv("festo_cmmp_as")
    env.reset(seed=1)
    with pytest.raises(
        ValueError, match=rf"method = {method} is not a search of drive 'festo_cmmp"
    ):
        env.built_in(method)


def test_the_switch_lies_elsewhere_in_each_episode_and_comes_back():
    env = HomingEnv(switch_tolerance=0.01)
    homes = []
    for seed in (1, 2, 1):
        env.reset(seed=seed)
        homes.append(float(env.episode._home))
    assert homes[0] != homes[1]
    assert homes[0] == homes[2]
    assert all(abs(home - 0.1997) <= 0.01 for home in homes)


def test_a_reference_taken_elsewhere_ends_as_missed():
    env = HomingEnv()
    env.reset(seed=1, options={"start": 0.3, "switch_offset": 0.0})
    *_, reward, terminated, _, info = env.step(np.array([0, 1, 1], np.float32))
    assert terminated
    assert info["attained"]
    assert not info["is_success"]
    assert info["error"] == pytest.approx(0.3 - 0.1997, abs=1e-6)
    assert reward < 1e-5


def test_the_agent_remembers_the_switches_it_met_and_where():
    env = HomingEnv()
    seen, _ = env.reset(seed=1, options={"start": 0.15, "switch_offset": 0.0})
    assert seen[9:].tolist() == [0.0, 0.0, 0.0, 0.0]
    for _ in range(80):
        seen = env.step(np.array([0.5, 1, -1], np.float32))[0]
    coupling = env.machine.couplings[0]
    edge = float(coupling.switch_to[HOME] + coupling.switch_hysteresis[HOME])  # left last
    position = float(env.machine.data.qpos[0])
    assert position > edge
    assert seen[9] == 1.0
    half = 0.5 * 0.25 * env.step_time  # m, way of half a step, in which the switch let go
    assert seen[10] == pytest.approx((position - edge) / 0.05, abs=half / 0.05)
    assert seen[11] == 1.0, "farther than the fine one can tell"
    for _ in range(250):
        seen = env.step(np.array([0.5, 1, -1], np.float32))[0]
    assert seen[12] == 1.0, "the positive limit switch"


def test_the_torque_limit_reaches_the_drive_and_is_forgotten_at_the_reset():
    env = HomingEnv()
    env.reset(seed=1)
    env.step(np.array([0, -1, -1], np.float32))
    assert env.drive.read("max_torque") == 150
    env.reset(seed=1)
    assert env.drive.read("max_torque") == 3000


def test_with_the_other_face_the_agent_references_by_mode_and_bit_4():
    env = HomingEnv(action="pdo")
    observation, info = env.reset(seed=1, options={"start": 0.3})
    assert info["state"] == "SWITCH_ON_DISABLED"

    def act(control, mode):
        bits = [1.0 if control >> bit & 1 else -1.0 for bit in range(9)]
        return env.step(np.array([0, 1, 1, *bits, mode], np.float32))

    state = State.SWITCH_ON_DISABLED
    while state != State.OPERATION_ENABLED:
        observation, *_, terminated, _, info = act(TO_ENABLED[state], 1.0)
        state = state_of(
            sum(1 << bit for bit in range(16) if observation[width(env.OBSERVATION) + bit] > 0.5)
        )
        assert not terminated, "component 2 has no effect here"
    act(ENABLED, 1.0)
    *_, terminated, _, info = act(ENABLED | 0x10, 1.0)
    assert terminated
    assert info["attained"]


def test_a_fault_ends_the_episode_with_its_code():
    env = HomingEnv(faults={"encoder_loss": 1.0})
    env.reset(seed=1)
    *_, terminated, _, info = env.step(np.array([0, 1, -1], np.float32))
    assert terminated
    assert info["fault"].startswith("7305h")
    assert not info["is_success"]


def test_a_vector_is_bit_for_bit_the_environments_one_by_one():
    arguments = {"max_velocity": 1.0, "randomise": {"friction": (0.5, 2.0), "payload": (1, 9)}}
    peers = SyncVectorEnv(
        [lambda: gym.wrappers.TimeLimit(HomingEnv(**arguments), 40) for _ in range(3)]
    )
    vector = ServoVectorEnv(HomingEnv, 3, threads=2, max_episode_steps=40, **arguments)
    np.testing.assert_array_equal(peers.reset(seed=7)[0], vector.reset(seed=7)[0])
    generator = np.random.default_rng(1)
    ends = 0
    for _ in range(100):
        action = generator.uniform(-1, 1, (3, 3)).astype(np.float32)
        action[:, 2] = np.where(generator.random(3) < 0.03, 1.0, -1.0)
        expected, got = peers.step(action), vector.step(action)
        for a, b in zip(expected[:4], got[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        ends += got[2].sum()
    assert ends >= 2
    peers.close()
    vector.close()


def test_gymnasium_makes_it_by_its_id():
    env = gym.make(f"servogym.envs:{HomingEnv.ID}", drive="kollmorgen_akd")
    assert isinstance(env.unwrapped, HomingEnv)
    assert env.spec.max_episode_steps == HomingEnv.STEPS
    vector = gym.make_vec(HomingEnv.ID, num_envs=2)
    assert vector.reset(seed=1)[0].shape == (2, *env.observation_space.shape)
    vector.close()


def test_a_pickled_environment_goes_on_bit_for_bit():
    env = HomingEnv(reference="negative_limit_switch", randomise={"friction": (0.5, 2.0)})
    env.reset(seed=5)
    for _ in range(30):
        env.step(np.array([-0.4, 0.3, -1], np.float32))
    again = pickle.loads(pickle.dumps(env))
    for _ in range(30):
        one, other = (e.step(np.array([-0.4, 0.3, -1], np.float32)) for e in (env, again))
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1:] == other[1:]
    np.testing.assert_array_equal(env.reset()[0], again.reset()[0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"reference": "moon"}, "reference = 'moon': choose one of home_switch"),
        ({"max_velocity": 9.0}, r"max_velocity = 9.0 is out of range 0.01..2 m/s"),
        ({"tolerance": -1}, "tolerance = -1"),
        ({"switch_tolerance": 1}, "switch_tolerance = 1"),
        ({"payload": -1.0}, "payload = -1.0"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        HomingEnv(**arguments)


@pytest.mark.parametrize("option", ["start", "switch_offset"])
def test_wrong_options_are_named(option):
    with pytest.raises(ValueError, match=option):
        HomingEnv().reset(options={option: 7.0})
