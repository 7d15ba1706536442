"""servogym/Commissioning-v0: a PLC's step chain does it, chance and patience do not."""

import pickle
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

import servogym.envs
from servogym.drive.kernel.words import ENABLED, TO_ENABLED, Mode, State
from servogym.drive.kernel.words import Controlword as C
from servogym.drive.model.model import load, model_names
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.commissioning import CAUSES, CommissioningEnv
from servogym.training.policies import make
from servogym.training.policies.datasheet import datasheet
from servogym.training.policies.plc import SHOWN
from servogym.training.policies.plc import action as plc_action

assert servogym.envs


@cache
def sheet():
    return datasheet(CommissioningEnv())


def action(*arguments):
    """Controlword, mode and target position as an action."""
    return plc_action(sheet(), *arguments)


def hold():
    return action(0, Mode.HOMING, 0.0)


MILESTONES = ("fault_cleared", "operation_enabled", "homed", "moving", "in_position")
CAPABLE = [name for name in model_names() if Mode.HOMING in load(name).modes]


def play(env, seen):
    """-> rewards by name, the last info."""
    policy = make("plc", env)
    policy.reset(seen, {})
    got = dict.fromkeys(MILESTONES, 0.0)
    for _ in range(env.STEPS):
        seen, reward, terminated, _, info = env.step(policy.act(seen))
        assert env.observation_space.contains(seen)
        for name in MILESTONES:
            got[name] += info[f"reward_{name}"]
        if info["milestones"] >= 2:
            assert not info["fault"].startswith("8611h"), "the search ran against the end stop"
        if info["reward_moving"]:
            assert SHOWN[float(seen[22])] == Mode.PROFILE_POSITION
            assert abs(seen[2]) > 0
        assert reward == pytest.approx(sum(info[f"reward_{name}"] for name in MILESTONES) / 5)
        if terminated:
            break
    return got, info


@pytest.mark.parametrize("model", model_names())
def test_a_plc_does_it_with_every_drive_model_that_can_home(model):
    if model not in CAPABLE:
        with pytest.raises(ValueError, match="has no mode homing"):
            CommissioningEnv(drive=model)
        return
    env = CommissioningEnv(drive=model)
    check_env(env, skip_render_check=True)
    assert len(env.causes) >= 5
    for seed, cause in enumerate(env.causes):
        seen, info = env.reset(seed=seed, options={"cause": cause})
        assert info["fault"], cause
        assert info["injected"] == (cause,)
        assert seen[5] == 0.0
        got, info = play(env, seen)
        assert got == dict.fromkeys(MILESTONES, 1.0), (cause, env.drive.describe())
        assert info["is_success"]
        assert abs(env.machine.data.qpos[0] - info["goal"]) < 1.5e-3, "the reference is a true one"


def test_holding_still_earns_nothing():
    env = CommissioningEnv()
    env.reset(seed=1)
    assert sum(env.step(hold())[1] for _ in range(500)) == 0.0


def test_random_actions_do_not_come_to_a_reference():
    env = CommissioningEnv()
    generator = np.random.default_rng(3)
    for seed in range(3):
        env.reset(seed=seed)
        for _ in range(1000):
            *_, terminated, _, info = env.step(generator.uniform(-1, 1, 11).astype(np.float32))
            assert not terminated
        assert info["milestones"] <= 2


def test_the_fault_can_be_reset_only_when_its_cause_has_gone():
    env = CommissioningEnv()
    env.reset(seed=1, options={"cause": "overvoltage", "outage": 20})
    cleared = None
    for step in range(40):
        control = C.FAULT_RESET if step % 2 else 0
        *_, info = env.step(action(control, Mode.HOMING, 0.0))
        if cleared is None and info["reward_fault_cleared"]:
            cleared = step
    assert 20 <= cleared <= 22
    assert info["state"] == "SWITCH_ON_DISABLED"


def test_a_new_fault_does_not_end_the_episode_and_its_cause_goes_as_well():
    env = CommissioningEnv(faults={"short_circuit": 0.004}, outage=5)
    seen, _ = env.reset(seed=3)
    got, info = play(env, seen)
    assert len(info["injected"]) > 1
    assert sum(got.values()) == 5


def test_in_position_counts_only_after_homing():
    """Switched on and already at the goal, in pp: that is not a milestone without a reference."""
    env = CommissioningEnv()
    env.reset(seed=1, options={"start": 0.1, "goal": 0.1, "outage": 0})
    reset, total = False, 0.0
    for _ in range(100):
        state = env.drive.state
        reset = state == State.FAULT and not reset
        control = C.FAULT_RESET if reset else TO_ENABLED[state]
        _, reward, *_ = env.step(action(control, Mode.PROFILE_POSITION, -0.6))
        total += reward
    assert env.drive.state == State.OPERATION_ENABLED
    assert total == pytest.approx(0.4)


def test_a_vector_is_bit_for_bit_the_environments_one_by_one():
    arguments = {"outage": 2, "faults": {"overvoltage": 0.02}}
    peers = SyncVectorEnv(
        [lambda: gym.wrappers.TimeLimit(CommissioningEnv(**arguments), 50) for _ in range(3)]
    )
    vector = ServoVectorEnv(CommissioningEnv, 3, threads=2, max_episode_steps=50, **arguments)
    seen, _ = peers.reset(seed=7)
    np.testing.assert_array_equal(seen, vector.reset(seed=7)[0])
    policies = [make("plc", env) for env in vector.envs]
    for policy, row in zip(policies, seen, strict=True):
        policy.reset(row, {})
    total = 0.0
    for _ in range(120):
        actions = np.stack([policy.act(row) for policy, row in zip(policies, seen, strict=True)])
        expected, got = peers.step(actions), vector.step(actions)
        for a, b in zip(expected[:4], got[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        seen = got[0]
        total += got[1].sum()
    assert total > 0.5
    peers.close()
    vector.close()


def test_gymnasium_makes_it_by_its_id():
    env = gym.make(f"servogym.envs:{CommissioningEnv.ID}", drive="kollmorgen_akd")
    assert isinstance(env.unwrapped, CommissioningEnv)
    assert env.spec.max_episode_steps == CommissioningEnv.STEPS
    vector = gym.make_vec(CommissioningEnv.ID, num_envs=2)
    assert vector.reset(seed=1)[0].shape == (2, *env.observation_space.shape)
    vector.close()


def test_a_pickled_environment_goes_on_bit_for_bit():
    env = CommissioningEnv()
    env.reset(seed=5, options={"outage": 15})
    for _ in range(10):
        env.step(hold())
    again = pickle.loads(pickle.dumps(env))
    for step in range(30):
        given = action(C.FAULT_RESET if step % 2 else ENABLED, Mode.HOMING, 0.3)
        one, other = env.step(given), again.step(given)
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1:] == other[1:]
    assert env.episode.milestones > 0
    np.testing.assert_array_equal(env.reset()[0], again.reset()[0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"action": "setpoint"}, "action = 'setpoint': here the agent is the whole master"),
        ({"causes": ("gremlin",)}, r"causes = \('gremlin',\), choose some of encoder_loss"),
        ({"causes": ()}, r"causes = \(\), choose some of"),
        ({"outage": -1}, r"outage = -1 is out of range 0..1000 steps"),
        ({"tolerance": 0.0}, "tolerance = 0.0"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        CommissioningEnv(**arguments)


@pytest.mark.parametrize("option", ["start", "goal", "cause", "outage"])
def test_wrong_options_are_named(option):
    with pytest.raises(ValueError, match=option):
        CommissioningEnv().reset(options={option: 7000})


def test_a_cause_that_is_only_a_warning_is_not_drawn():
    env = CommissioningEnv("festo_cmmp_as")
    assert set(env.causes) < set(CAUSES)
    with pytest.raises(ValueError, match=r"following_error.*choose some"):
        CommissioningEnv("festo_cmmp_as", causes=("following_error",))
