"""Identifying, squaring, contouring: each against what is known of the machine."""

import math

import numpy as np
import pytest

from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.envs.tasks.contour import GantryContourEnv
from servogym.envs.tasks.gantry_sync import GantrySyncEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.tasks.tracking import LinearAxisTrackingEnv
from servogym.training.policies import make
from servogym.training.policies.adaptive_feed_forward import SURE
from servogym.training.policies.datasheet import datasheet


def play(env, policy, seed=3, steps=None, **options):
    """-> the last info."""
    observation, info = env.reset(seed=seed, options=options)
    policy.reset(observation, info)
    for _ in range(steps or env.STEPS):
        observation, _, terminated, _, info = env.step(policy.act(observation))
        assert not terminated
    return info


@pytest.mark.parametrize("payload", [1.0, 10.0])
@pytest.mark.parametrize("friction", [0.5, 2.0])
def test_mass_and_friction_are_found(payload, friction):
    env = LinearAxisTrackingEnv(
        reference="sine", randomise={"payload": payload, "friction": friction}
    )
    policy = make("adaptive_feed_forward", env)
    play(env, policy, seed=7)
    mass, share = policy.found
    axis = datasheet(env).axis
    assert abs(share - friction) < 0.35 * abs(1.0 - friction)  # 1 was the first guess
    assert mass == pytest.approx(axis.mass(payload), abs=2.0)  # and 5 kg of payload


@pytest.mark.parametrize("cycles", [0.0, 1.0, 2.0])
def test_a_late_set_point_is_led_by_the_delay(cycles):
    env = LinearAxisTrackingEnv(reference="sweep", randomise={"delay": cycles})
    policy = make("leading_feed_forward", env)
    led = play(env, policy, seed=7)["rms_load_error"]
    late = cycles * env.machine.cycle_time / env.step_time  # in steps
    assert max(policy.lag - SURE, 0.0) == pytest.approx(late, abs=0.02)
    followed = play(env, make("adaptive_feed_forward", env), seed=7)["rms_load_error"]
    assert led < 0.3 * followed if cycles else led == followed


def test_the_informed_law_of_tracking_begins_with_what_was_drawn():
    env = LinearAxisTrackingEnv(randomise={"payload": 9.0, "friction": 0.6})
    policy = make("informed_adaptive_feed_forward", env)
    play(env, policy, steps=5)
    assert policy.found.tolist() == pytest.approx([datasheet(env).axis.mass(9.0), 0.6])


def test_tracking_errors_fall_from_hold_to_feed_forward_to_the_one_that_adapts():
    env = LinearAxisTrackingEnv(
        reference="pick_and_place", randomise={"payload": 9.0, "friction": 1.8}
    )
    names = ("hold", "feed_forward", "adaptive_feed_forward")
    errors = [play(env, make(name, env), seed=5)["rms_load_error"] for name in names]
    assert errors[0] > errors[1] > errors[2]


@pytest.mark.parametrize("skew", [-3e-3, 0.0, 3e-3])
@pytest.mark.parametrize("name", ["squaring", "informed_squaring"])
def test_a_bridge_comes_square_to_its_goal(skew, name):
    env = GantrySyncEnv(randomise={})
    info = play(env, make(name, env), skew=skew)
    assert info["is_success"]
    assert abs(info["skew"]) < env.skew_tolerance


@pytest.mark.parametrize("contour", ["circle", "square"])
@pytest.mark.parametrize("feed", [0.1, 0.2])
def test_full_feed_is_nearer_to_the_contour_than_the_drives_alone_though_they_go_slower(
    contour, feed
):
    env = GantryContourEnv(contour=contour, feed=feed)
    held, full = (play(env, make(name, env)) for name in ("hold", "full_feed"))
    assert full["mean_error"] < held["mean_error"]
    assert full["progress"] > 1.2 * held["progress"]


def test_the_circle_of_a_first_order_follower_is_smaller_by_half_its_lag_squared():
    """Closed form: a lag T at speed v leaves (vT)² / 2R; full feed leaves a tenth of that."""
    env = GantryContourEnv(radius=0.04, feed=0.2)
    lag = datasheet(env).axis.lag
    shrunk = (0.2 * lag) ** 2 / (2.0 * 0.04)
    _, info = env.reset(seed=1)
    for _ in range(env.STEPS):
        *_, info = env.step(np.array([0.0, 0.0, 1.0], np.float32))
    assert info["mean_error"] == pytest.approx(shrunk, rel=0.3)
    assert play(env, make("full_feed", env))["mean_error"] < 0.15 * shrunk


def test_an_informed_law_is_told_the_resonance_and_the_data_sheet_is_not():
    env = CompliantAxisEnv(randomise={"payload": 2.0, "stiffness": 2.0})
    env.reset(seed=1)
    told = datasheet(env, env.parameters).axis
    known = datasheet(env).axis
    assert told.vibration.frequency == pytest.approx(math.sqrt(2.0 * 20e3 / 2.0))
    assert known.vibration.frequency == pytest.approx(math.sqrt(20e3 / 5.0))
    assert (told.payload, known.payload) == (2.0, 5.0)


def test_the_informed_law_of_a_heavy_load_is_slower_than_that_of_a_light_one():
    """Time-optimal with what the torque leaves: the mass is known, so it decides."""
    actions = []
    for payload in (1.0, 10.0):
        env = LinearAxisEnv(randomise={"payload": payload})
        policy = make("informed_ruckig", env)
        observation, info = env.reset(seed=1, options={"start": 0.1, "goal": 0.3})
        policy.reset(observation, info)
        actions.append([float(policy.act(observation)[0]) for _ in range(5)])
    assert sum(actions[0]) > sum(actions[1])


def test_a_task_with_nothing_to_be_told_says_so():
    with pytest.raises(ValueError, match=r"'informed_ruckig' is for .*LinearAxis-v0"):
        make("informed_ruckig", LinearAxisTrackingEnv())
