"""A task of one's own without a data sheet of its axes."""

import pytest

from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.training.policies import make


class BareEnv(LinearAxisEnv):
    """A task that forgot to tell what it moves."""

    ID, REFERENCE = "test/Bare-v0", "proportional"


def test_a_baseline_says_that_it_is_the_reference_that_lacks_the_data_sheet():
    env = BareEnv()
    env.datasheet = None
    make("hold", env)
    with pytest.raises(ValueError, match=r"which its baselines need, that of REFERENCE too: give"):
        make("proportional", env)
