"""Intervals of trainings and episodes: against brute force, closed forms and scipy."""

import math

import numpy as np
import pytest

from servogym.training.evaluate.metrics import (
    Summary,
    _wilson,
    difference,
    iqm,
    mean,
    paired,
    summarise,
)
from servogym.training.evaluate.tables import best


def of_one(values):
    return np.atleast_2d(np.asarray(values, float))


def test_the_interquartile_mean_is_that_of_scipy_where_quarters_are_whole():
    stats = pytest.importorskip("scipy.stats")
    values = np.random.default_rng(1).exponential(size=(5, 48))
    assert iqm(values) == pytest.approx(stats.trim_mean(values, 0.25, axis=1))


def test_what_is_not_a_number_does_not_count():
    values = np.array([[3.0, math.nan, 1.0, 2.0, 9.0], [math.nan] * 5])
    assert iqm(values)[0] == iqm(np.array([1.0, 2.0, 3.0, 9.0]))
    assert mean(values)[0] == 3.75
    assert np.isnan(iqm(values)[1])
    assert np.isnan(mean(values)[1])


def test_one_training_has_the_interval_of_its_episodes():
    """Of the mean of a normal sample: Student's is the closed form."""
    stats = pytest.importorskip("scipy.stats")
    values = np.random.default_rng(2).normal(10.0, 2.0, 200)
    found = summarise(of_one(values), share=True)
    wanted = stats.t.interval(0.95, 199, values.mean(), stats.sem(values))
    assert (found.low, found.high) == pytest.approx(wanted, abs=0.03)


def test_trainings_that_differ_widen_the_interval_and_shared_episodes_do_too():
    """Mean of a two-way table: the variance is that of trainings / T plus that of episodes / E."""
    generator = np.random.default_rng(3)
    trainings, episodes = generator.normal(0, 1.0, 20), generator.normal(0, 3.0, 60)
    found = summarise(trainings[:, None] + episodes, share=True)
    deviation = math.sqrt(trainings.var() / 20 + episodes.var() / 60)
    assert (found.high - found.low) / (2 * 1.96) == pytest.approx(deviation, rel=0.06)
    alone = summarise(np.zeros((20, 1)) + episodes, share=True)
    assert (alone.high - alone.low) / (2 * 1.96) == pytest.approx(
        math.sqrt(episodes.var() / 60), rel=0.06
    ), "twenty copies of a training tell no more than one"


def test_the_interval_is_that_of_a_loop_over_resamples():
    generator = np.random.default_rng(4)
    values = generator.gamma(2.0, size=(5, 50)) + generator.gamma(1.0, size=(5, 1))
    found, estimates = summarise(values), []
    for _ in range(2000):
        of_trainings, of_episodes = generator.integers(0, 5, 5), generator.integers(0, 50, 50)
        estimates.append(iqm(np.concatenate([values[t][of_episodes] for t in of_trainings])))
    low, high = np.percentile(estimates, [2.5, 97.5])
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.08)
    assert found.iqm == iqm(values.ravel())


def test_the_interval_covers_the_true_value_about_as_often_as_it_says():
    generator, hits = np.random.default_rng(3), 0
    for _ in range(60):
        table = generator.normal(size=(12, 1)) + generator.normal(size=(1, 30))
        s = summarise(table)
        assert s.low <= s.iqm <= s.high
        hits += s.low <= 0.0 <= s.high
    assert 50 <= hits <= 60


def test_a_paired_difference_knows_what_both_have_in_common():
    generator = np.random.default_rng(5)
    hard = generator.exponential(10.0, 50)
    one, other = of_one(hard + 0.1), of_one(hard)
    found = difference(one, other)
    assert found == pytest.approx((0.1, 0.1, 0.1))
    assert summarise(one).low < summarise(other).high, "side by side nothing could be told"


def test_a_difference_has_the_trainings_of_both():
    generator = np.random.default_rng(6)
    one = np.zeros((5, 50)) + generator.normal(size=(5, 1))
    found = difference(one, np.zeros((1, 50)))
    assert found.high - found.low > 0.5


def test_a_share_of_all_episodes_leaves_room_for_what_was_not_met():
    stats = pytest.importorskip("scipy.stats")
    for hits in (0, 3, 47, 50):
        wanted = stats.binomtest(hits, 50).proportion_ci(method="wilson")
        assert _wilson(hits / 50, 50) == pytest.approx(tuple(wanted))
    found = summarise(np.ones((5, 50)), share=True)
    assert (found.mean, found.high) == (1.0, 1.0)
    assert found.low == pytest.approx(0.929, abs=1e-3), "five trainings on the same 50 episodes"
    assert summarise(np.zeros((1, 50))).high == 0.0, "a torque that is always 0 is not a share"


def test_the_worst_training_and_the_worst_episodes_are_on_the_bad_side():
    values = np.array([[1.0] * 20, [2.0] * 20])
    values[0, 0], values[1, 7] = 50.0, 100.0
    low, high = summarise(values, "low"), summarise(values, "high")
    assert (low.worst_training, low.tail) == (2.0, 75.0)  # 2 of 40 episodes
    assert (high.worst_training, high.tail) == (1.0, 1.0)
    assert np.isnan(summarise(values, "").tail)


def test_the_best_baseline_moves_and_is_no_learned_policy_nor_an_informed_one():
    def row(*values):
        return [None if v is None else Summary(v, v, v, v) for v in values]

    names = ["hold", "ruckig", "lqr", "learned", "built_in:17", "informed_ruckig"]
    table = {
        "settling_time": row(0.1, 2.0, 1.0, 0.5, 3.0, 0.3),
        "energy": row(None, None, 1.0, 1, None, 0.9),
    }
    assert best(table, names, "settling_time", "low") == "lqr"
    assert best(table, names, "settling_time", "high") == "built_in:17"
    assert best(table, ["hold", "learned"], "settling_time", "low") == "hold"
    assert best(table, names, "score", "high") == "hold", "no baseline has it: the first"


def test_the_mean_of_the_differences_is_not_the_difference_of_the_means():
    """One policy is better where it is hard: -0.941 and -0.605 µm were both called 27 %."""
    hard = np.array([[1.0, 1.0, 1.0, 1.0, 10.0, 10.0, 10.0, 10.0]])
    one = hard - np.array([[0.0, 0.0, 0.0, 0.0, 4.0, 4.0, 4.0, 4.0]])
    of_means, of_pairs = difference(one, hard), paired(one, hard, "low")
    assert of_means.value == pytest.approx(float(iqm(one)[0] - iqm(hard)[0]))
    assert of_pairs.iqm == pytest.approx(iqm(one - hard)[0])
    easy = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]])
    other_way = easy[:, ::-1] - 0.5  # the same distribution, half a unit lower
    assert difference(other_way, easy).value == pytest.approx(-0.5)
    assert paired(other_way, easy, "low").iqm == pytest.approx(-0.5)
    assert paired(other_way, easy, "low").improved == 0.5
    assert paired(easy - 0.5, easy, "low").improved == 1.0
    assert paired(easy - 0.5, easy, "high").improved == 0.0
    steep = easy - np.array([[0.0, 0.0, 0.0, 3.0, 3.0, 3.0, 0.0, 0.0]])
    assert difference(steep, easy).value != pytest.approx(paired(steep, easy, "low").iqm)


def test_the_probability_of_improvement_is_that_of_mann_and_whitney():
    stats = pytest.importorskip("scipy.stats")
    generator = np.random.default_rng(7)
    one, other = generator.normal(0.3, 1.0, (3, 20)), generator.normal(0.0, 1.0, (1, 20))
    other[0, :5] = one[0, :5]  # ties count half
    expected = stats.mannwhitneyu(one.ravel(), other.ravel()).statistic / (60 * 20)
    assert paired(one, other, "high").probability == pytest.approx(expected)
    assert paired(one, other, "low").probability == pytest.approx(1.0 - expected)


def test_the_episodes_needed_are_those_of_a_paired_t_test():
    """Of normal differences: n = ((z + z') σ / δ)², with the interquartile mean's efficiency."""
    generator = np.random.default_rng(8)
    base = np.full((1, 400), 10.0)
    apart = generator.normal(0.0, 3.0, (1, 400))
    found = paired(base + apart, base, "low").needed
    plain = ((1.96 + 0.8416) * 3.0 / 1.0) ** 2
    assert plain < found < 1.5 * plain  # 1 / 0.84: what trimming a quarter costs at a normal


def test_with_the_episodes_needed_four_of_five_experiments_see_the_difference():
    """Played out: experiments of as many episodes, each with a bootstrap written here."""
    generator = np.random.default_rng(9)
    base = np.full((1, 200), 10.0)
    found = paired(base + generator.normal(0.0, 3.0, (1, 200)), base, "low").needed
    n, seen = round(found), 0
    for _ in range(150):
        apart = generator.normal(1.0, 3.0, n)  # a tenth of 10
        drawn = np.sort(apart[generator.integers(0, n, (300, n))], axis=1)
        seen += np.percentile(drawn[:, n // 4 : n - n // 4].mean(axis=1), 2.5) > 0.0
    assert 0.65 < seen / 150 < 0.95


def test_no_number_of_episodes_makes_up_for_trainings_that_differ():
    generator = np.random.default_rng(10)
    base = np.full((1, 50), 10.0)
    noise = generator.normal(0.0, 0.5, (5, 50))
    apart = np.array([[-4.0], [-2.0], [0.0], [2.0], [4.0]])
    assert paired(base + noise, base, "low").needed < 50
    assert paired(base + apart + noise, base, "low").needed == np.inf
    assert paired(base, base, "low").needed == 2.0, "a single one shows no spread"
