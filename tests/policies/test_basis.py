"""Feed-forward by basis functions: the fit against a closed form, and what it is worth."""

import numpy as np
import pytest

from servogym.envs.tasks.tracking import LinearAxisTrackingEnv
from servogym.training import cli
from servogym.training.evaluate import comparison
from servogym.training.policies import make
from servogym.training.policies.basis_feed_forward import (
    FILE,
    BasisFeedForward,
    Reference,
    fit,
    fitted,
)
from servogym.training.policies.datasheet import datasheet

METRIC = LinearAxisTrackingEnv.METRIC


def test_it_is_ahead_of_the_law_it_stands_on_and_of_what_was_learned():
    """On episodes on which nothing was chosen; 50 of seed 0 are on the page."""
    names = ["leading_feed_forward", "basis_feed_forward"]
    law, basis = (
        result.by_training(METRIC)
        for result in comparison.evaluate(LinearAxisTrackingEnv.ID, names, "generic", 6, 4242)
    )
    assert (basis < law).mean() > 0.8
    assert np.median(basis / law) < 0.8


def test_coefficients_of_0_are_the_law_below_but_for_its_loop():
    env = LinearAxisTrackingEnv()
    basis = BasisFeedForward(datasheet(env), 0, np.zeros_like(fitted()))
    law = make("leading_feed_forward", env)
    seen, info = env.reset(seed=1)
    for policy in (basis, law):
        policy.reset(seen, info)
    for _ in range(50):
        action, own = basis.act(seen), law.act(seen)
        assert action[1] == own[1]
        assert action[0] == pytest.approx(0.6 * own[0], abs=1e-6)
        seen, *_ = env.step(own)


def test_the_basis_functions_see_what_is_ahead():
    """Closed form: with constant velocity all windows are that velocity, and no acceleration is."""
    known = datasheet(LinearAxisTrackingEnv())
    record = np.zeros(1, known.observation_record)
    record["reference_velocity"] = record["preview"] = 0.25
    reference = Reference(known)
    for _ in range(5):
        reference.see(record.view(np.float32).ravel())
    speed = 0.25 * known.axis.fastest
    functions = reference.functions(0.5, -0.25)
    assert functions[:10] == pytest.approx([speed] * 8 + [0.0] * 2)
    assert functions[10:20] == pytest.approx(0.5 * functions[:10])
    assert functions[20:28] == pytest.approx([np.tanh(speed / 3e-3)] * 8)
    assert functions[-8:] == pytest.approx([-0.25 * speed] * 8)
    assert functions.shape == fitted().shape


@pytest.mark.slow
def test_the_command_finds_the_coefficients_again(tmp_path, capsys):
    file = tmp_path / "tuned.npz"
    assert cli.main(["tune-policy", "basis_feed_forward", "--out", str(file)]) == 0
    assert "281,600 steps" in " ".join(capsys.readouterr().out.split())
    with np.load(file) as again, np.load(FILE) as kept:
        np.testing.assert_allclose(again["coefficients"], kept["coefficients"], rtol=1e-6)


def test_a_fit_of_a_few_episodes_gives_numbers_and_says_its_steps():
    numbers, steps = fit(LinearAxisTrackingEnv, 2)
    assert np.isfinite(numbers).all()
    assert steps == 11 * 2 * 400


def test_what_is_not_tuned_by_a_command_is_told(tmp_path, capsys):
    assert cli.main(["tune-policy", "basis_feedforward", "--out", str(tmp_path / "x")]) == 2
    assert "did you mean basis_feed_forward" in capsys.readouterr().err
