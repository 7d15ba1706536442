"""servogym/GantrySync-v0: squaring on the way."""

import numpy as np
import pytest

from servogym.drive.kernel.words import State
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.gantry_sync import GantrySyncEnv

MAX_TWIST = 0.01  # m


def together(observation):
    """Both set-points at one speed to the goal, slower until the switches have been met."""
    limit = 0.5 if observation[11] else 0.15
    return np.full(2, np.clip(20.0 * (observation[0] + observation[5]), -limit, limit))


def cross_coupled(observation):
    """The same, and what the switches have told of the skew is taken back."""
    skew = (observation[10] - observation[12]) * MAX_TWIST if observation[11] else 0.0
    back = np.clip(150.0 * skew, -0.3, 0.3) * np.array([1.0, -1.0])
    return np.clip(together(observation) + back, -1.0, 1.0)


def still(observation):
    return np.zeros(2)


def play(policy, seed, **options):
    """Return (mean reward a step) and the last info."""
    env = GantrySyncEnv()
    observation, _ = env.reset(seed=seed, options=options)
    total = 0.0
    for _ in range(GantrySyncEnv.STEPS):
        observation, reward, terminated, _, info = env.step(policy(observation))
        assert not terminated
        total += reward
    return total / GantrySyncEnv.STEPS, info


@pytest.mark.parametrize("skew", [-2e-3, 2.4e-3])
def test_a_cross_coupled_master_squares_the_bridge_and_beats_holding_still(skew):
    options = {"start": 0.18, "goal": 0.28, "skew": skew}
    squared, info = play(cross_coupled, 2, **options)
    skewed, other = play(together, 2, **options)
    held, _ = play(still, 2, **options)
    assert abs(info["skew"]) < 0.2e-3
    assert abs(other["skew"]) > 0.9 * abs(skew)
    assert squared > skewed + 0.2
    assert skewed > held + 0.1


def test_the_drives_show_a_square_bridge_where_it_lies_skew():
    env = GantrySyncEnv()
    observation, info = env.reset(seed=2, options={"skew": 2e-3})
    assert info["skew"] == pytest.approx(2e-3, rel=0.02)
    assert observation[0] == pytest.approx(observation[5], abs=1e-4)
    assert observation[10] == pytest.approx(0.0, abs=5e-3)


def test_the_switches_tell_the_skew_to_a_few_tenths_of_a_millimetre():
    env = GantrySyncEnv()
    observation, _ = env.reset(seed=2, options={"start": 0.19, "goal": 0.3, "skew": 2e-3})
    while not observation[11]:
        observation, *_, info = env.step(np.full(2, 0.1))
    told = (observation[10] - observation[12]) * MAX_TWIST
    assert told == pytest.approx(info["skew"], abs=0.2e-3)


def test_too_much_twist_terminates_and_says_so():
    env = GantrySyncEnv()
    env.reset(seed=1)
    terminated = False
    while not terminated:
        *_, terminated, _, info = env.step(np.array([1.0, -1.0]))
    assert info["twisted"]
    assert info["fault"] == ""
    assert info["skew"] < -MAX_TWIST


def test_the_load_is_drawn_and_told_unless_it_is_said_not_to():
    env = GantrySyncEnv()
    env.reset(seed=1)
    first = env.info()["parameters"]
    env.reset()
    assert set(first) == {"payload", "friction"}
    assert env.info()["parameters"] != first
    assert env.machine.model.body("payload").mass == env.info()["parameters"]["payload"]
    assert GantrySyncEnv(randomise={}).reset(seed=1)[1]["parameters"] == {}


def test_the_skew_of_each_is_its_own_in_a_vector():
    vector = ServoVectorEnv(GantrySyncEnv, 3, threads=1, randomise={})
    _, infos = vector.reset(seed=4)
    assert len(set(infos["skew"])) == 3
    before = infos["skew"].copy()
    *_, infos = vector.step(np.zeros((3, 2)))
    np.testing.assert_allclose(infos["skew"], before, atol=0.1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"skew": 0.02}, r"skew = 0.02 is out of range 0..0.01 m"),
        ({"max_twist": 0.05}, r"max_twist = 0.05 is out of range 0.001..0.03 m"),
        ({"speed": 0.0}, r"speed = 0.0 is out of range 0.001..1 m/s"),
        ({"skew_tolerance": 1.0}, "skew_tolerance"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        GantrySyncEnv(**arguments)


def test_wrong_options_are_named():
    with pytest.raises(ValueError, match=r"options\['skew'\] = 0.5 is out of range -0.01..0.01 m"):
        GantrySyncEnv().reset(options={"skew": 0.5})


def test_the_ghost_of_the_bridge_is_at_the_goal():
    env = GantrySyncEnv()
    _, info = env.reset(seed=2)
    assert env.ghosts()["bridge"].tolist() == pytest.approx([info["distance"], 0.0, 0.0], abs=1e-5)


@pytest.mark.parametrize("drive", ["x1", "x2"])
def test_a_fault_reaches_the_drive_it_is_declared_for(drive):
    env = GantrySyncEnv(faults={f"{drive}.short_circuit": 1.0})
    env.reset(seed=1)
    *_, terminated, _, info = env.step(np.zeros(env.action_space.shape))
    assert terminated
    assert info["injected"] == (f"{drive}.short_circuit",)
    states = [env.machine.drives[name].state for name in ("x1", "x2")]
    assert [state == State.FAULT for state in states] == [drive == "x1", drive == "x2"]


def test_a_fault_without_a_drive_may_reach_each_of_them():
    env = GantrySyncEnv(faults={"short_circuit": 0.3})
    seen = set()
    for seed in range(12):
        env.reset(seed=seed)
        for _ in range(4):
            *_, terminated, _, info = env.step(np.zeros(env.action_space.shape))
            seen.update(info["injected"])
            if terminated:
                break
    assert seen == {"x1.short_circuit", "x2.short_circuit"}
    with pytest.raises(ValueError, match="there is no drive 'z': choose one of x1, x2"):
        GantrySyncEnv(faults={"z.short_circuit": 0.1})
