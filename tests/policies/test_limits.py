"""Baselines of motion engineering and limits: each against what is known of it in closed form."""

import numpy as np
import pytest

from servogym.envs import ON_MODELS, TASKS
from servogym.envs.tasks.commissioning import CommissioningEnv
from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.envs.tasks.homing import HomingEnv
from servogym.envs.tasks.tracking import LinearAxisTrackingEnv
from servogym.training.evaluate import comparison, tables, tuner
from servogym.training.policies import ANYWHERE, POLICIES, make
from servogym.training.policies.datasheet import datasheet
from servogym.training.policies.lqr import gain

MOVE = {"start": 0.1, "goal": 0.3}


def play(env, policy, steps=None, **options):
    """-> the last info."""
    observation, info = env.reset(seed=3, options=options)
    policy.reset(observation, info)
    for _ in range(steps or env.STEPS):
        observation, _, terminated, _, info = env.step(policy.act(observation))
        if terminated:
            break
    return info


@pytest.mark.parametrize("task", [*TASKS, *ON_MODELS], ids=lambda task: task.ID)
def test_every_task_has_three_classical_rows_one_of_them_tuned_a_told_row_and_a_bound(task):
    assert ANYWHERE == ("hold", "random")
    rivals = [name for name in task.POLICIES if not POLICIES[name].informed]
    assert len(rivals) >= 3
    assert {*rivals} & {*tuner.FITTED, *tuner.offered()}
    assert [name for name in task.POLICIES if POLICIES[name].informed and name != "bound"]
    assert "bound" in task.POLICIES


def test_a_bound_is_a_row_of_settling_time_alone_and_below_all_others(tmp_path):
    results = comparison.evaluate("LinearAxis-v0", ["ruckig", "bound"], "generic", 2, 7)
    table = tables.summaries(results)
    assert [s is None for s in table["episode_return"]] == [False, True]
    times = [result.values["settling_time"] for result in results]
    assert (times[1] < times[0]).all()
    assert tables.best(table, ["ruckig", "bound"], "settling_time", "low") == "ruckig"


def test_the_first_rehearsal_is_the_episode_as_it_would_be_and_the_eighth_a_fifth_of_its_error():
    env = LinearAxisTrackingEnv(randomise={"payload": 8.0, "friction": 1.5})
    plain = play(env, make("feed_forward", env), reference="s_curve")["rms_error"]
    policy = make("iterative_learning", env)
    rehearsed, learn = [], policy.learn
    policy.learn = lambda errors: (rehearsed.append(errors.copy()), learn(errors))
    played = play(env, policy, reference="s_curve")["rms_error"]
    first = env.correction * np.sqrt(np.mean(rehearsed[0] ** 2))
    assert first == pytest.approx(plain, rel=1e-4)
    assert len(rehearsed) == 8
    assert played < 0.2 * plain


def test_a_rehearsal_meets_another_noise():
    env = LinearAxisTrackingEnv(randomise={"encoder_noise": 5e-6})
    policy = make("iterative_learning", env)
    observation, info = env.reset(seed=1)
    policy.reset(observation, info)
    own = env.machine.couplings["noise_state"].tolist()
    env.restore(env.snapshot())
    assert env.machine.couplings["noise_state"].tolist() == own, "that of the episode is kept"
    assert policy._twin.machine.couplings["noise_state"].tolist() != own


def test_the_observer_finds_a_constant_force():
    env = LinearAxisTrackingEnv()
    policy = make("disturbance_observer", env)
    policy.reset(env.reset(seed=1)[0], {})
    for _ in range(60):
        policy.observe(0.0, 0.0, 10.0)
    assert policy.force == pytest.approx(10.0, rel=1e-3)


def test_a_notch_leaves_less_vibration():
    env = CompliantAxisEnv(randomise={})
    energy = [play(env, make(n, env), **MOVE)["energy"] for n in ("ruckig", "ruckig+notch")]
    assert energy[1] < 0.05 * energy[0]


def test_within_its_limits_the_program_gives_what_the_regulator_would():
    """With the cost of an infinite horizon at its end: Bellman."""
    pytest.importorskip("osqp")
    env = CompliantAxisEnv(randomise={})
    axis = make("mpc", env)._axes[0]
    observation, _ = env.reset(seed=1, options={"start": 0.2, "goal": 0.2002})
    seen = datasheet(env).named(observation)
    axis.reset(seen)
    state = np.array([-axis._way, 0.0, 0.0, 0.0, 0.0])
    expected = -gain(axis._vibration, env.step_time) @ state
    assert abs(expected) < axis._change
    assert axis.act(seen) == pytest.approx(expected, rel=1e-3)


def test_the_program_keeps_to_its_limits_on_a_long_way():
    pytest.importorskip("osqp")
    env = CompliantAxisEnv(randomise={})
    assert play(env, make("mpc", env), start=0.05, goal=0.45)["is_success"]


def test_the_home_that_is_told_is_found_sooner_than_by_any_method():
    env = HomingEnv()
    info = play(env, make("informed_search", env), start=0.3)
    assert info["is_success"]
    fast = make("built_in_fast", env)
    env.reset(seed=3, options={"start": 0.3})
    assert info["time"] < env.judged(fast.method, fast.objects)["settling_time"]


def test_the_chain_by_the_clock_arrives_later_than_the_one_that_looks():
    env = CommissioningEnv()
    times = []
    for name in ("informed_plc", "plc", "plc_timed"):
        info = play(env, make(name, env))
        assert info["is_success"], name
        times.append(info["time"])
    assert times == sorted(times)
    assert times[2] > 2.0 * times[1]
