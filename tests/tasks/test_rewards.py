"""Logarithmic scales: something to gain at any distance, something to see at any distance."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.envs.tasks.rewards import closeness, decades
from servogym.envs.tasks.sway import GantrySwayEnv

FAR = 10_000.0
offs = st.floats(0.0, 2 * FAR)


@given(offs, offs)
def test_the_nearer_the_more_it_earns_within_0_and_1(one, other):
    near, far = sorted((one, other))
    assert 1.0 >= closeness(near, FAR) >= closeness(far, FAR) >= 0.0


def test_each_decade_earns_about_the_same():
    gains = [closeness(10.0**n, FAR) - closeness(10.0 ** (n + 1), FAR) for n in range(1, 4)]
    assert max(gains) < 1.15 * min(gains)
    assert closeness(0.0, FAR) == 1.0
    assert closeness(FAR, FAR) == pytest.approx(0.0)


@given(st.floats(-2 * FAR, 2 * FAR))
def test_what_is_seen_is_odd_and_can_be_turned_back_into_the_distance(off):
    seen = decades(off, FAR)
    assert -1.0 <= seen <= 1.0
    assert decades(-off, FAR) == -seen
    if abs(off) <= FAR:
        back = math.copysign(math.expm1(abs(seen) * math.log1p(FAR)), seen)
        assert back == pytest.approx(off, abs=1e-6)


@pytest.mark.parametrize("task", [CompliantAxisEnv, GantrySwayEnv])
def test_the_last_observation_is_the_distance_on_that_scale(task):
    env = task()
    seen, _ = env.reset(seed=3, options={"start": 0.3, "goal": 0.3 + 3 * env.tolerance})
    stroke = 0.8 if task is GantrySwayEnv else 0.5
    expected = math.log1p(3.0) / math.log1p(stroke / env.tolerance)
    assert seen[-1] == pytest.approx(expected, rel=0.02)
    far, _ = env.reset(seed=3, options={"start": 0.4, "goal": 0.1})
    assert -1.0 < far[-1] < -0.8
