"""Reference trajectories: within their limits, consistent, at rest at both ends."""

import numpy as np
import pytest

from servogym.envs.tasks.references import REFERENCES, Limits, make_reference

LIMITS = Limits(low=0.0, high=0.5, velocity=1.0, acceleration=10.0, jerk=1000.0)
SLACK = 1 + 1e-9
TIMES = {f"{400 * step:g} s": np.arange(401) * step for step in (0.25e-3, 5e-3, 1.0)}
SMOOTH = [name for name in REFERENCES if name != "step"]


def made(name, seed, times=TIMES["2 s"], **more):
    generator = np.random.default_rng(seed)
    start = generator.uniform(LIMITS.low, LIMITS.high)
    return start, make_reference(name, generator, LIMITS, start, times, **more)


@pytest.mark.parametrize("times", TIMES.values(), ids=TIMES)
@pytest.mark.parametrize("name", REFERENCES)
def test_it_moves_within_its_limits_from_rest_to_rest(name, times):
    for seed in range(30):
        start, reference = made(name, seed, times)
        assert all(len(samples) == len(times) for samples in reference)
        assert reference.position[0] == pytest.approx(start, abs=1e-12)
        assert np.ptp(reference.position) > 1e-6
        assert reference.position.min() >= LIMITS.low - 1e-9
        assert reference.position.max() <= LIMITS.high + 1e-9
        assert np.abs(reference.velocity).max() <= LIMITS.velocity * SLACK
        assert np.abs(reference.acceleration).max() <= LIMITS.acceleration * SLACK
        steepest = np.abs(np.diff(reference.position)).max() / (times[1] - times[0])
        assert steepest <= LIMITS.velocity * SLACK
        assert reference.velocity[0] == 0.0
        assert reference.velocity[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", SMOOTH)
def test_velocity_and_acceleration_are_those_of_the_position(name):
    times = np.arange(20_001) * 1e-4
    for seed in range(5):
        _, reference = made(name, seed, times)
        bound = 1e-4 * LIMITS.acceleration
        np.testing.assert_allclose(
            np.gradient(reference.position, times), reference.velocity, atol=bound
        )
        gradient = np.gradient(reference.velocity, times)
        jumps = np.abs(gradient - reference.acceleration) > 1e-4 * LIMITS.jerk
        assert jumps.sum() <= 4, "a sine begins and ends with a step of the acceleration"


def test_given_way_points_are_visited_in_their_order():
    points = [0.2, 0.45, 0.3]
    _, reference = made("way_points", 1, way_points=points)
    resting = reference.position[reference.velocity == 0.0]
    visited = [p for p, before in zip(resting[1:], resting, strict=False) if p != before]
    assert visited == pytest.approx(points)


def test_a_sweep_gets_faster_and_a_step_jumps_once():
    for seed in range(10):
        _, sweep = made("sweep", seed)
        turns = np.flatnonzero(np.diff(np.sign(sweep.velocity)))
        assert (np.diff(turns, 2) <= 1).all(), "half periods get shorter, to a sample"
        _, step = made("step", seed)
        assert np.count_nonzero(np.diff(step.position)) == 1


def test_one_seed_one_reference():
    for name in REFERENCES:
        one, other, another = (made(name, seed)[1].position.tobytes() for seed in (3, 3, 4))
        assert one == other
        assert one != another
