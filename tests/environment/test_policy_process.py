"""A policy in a process of its own: made once, made anew there, and replaced when it has ended."""

import os
import time

import numpy as np
import pytest

from servogym.envs.environment.policy_process import PolicyProcess
from servogym.envs.exchange.envelope import Stopped

SEEN = np.zeros(2, np.float32)


class Counts:
    """Its actions are the process it lives in and how often it has acted, across episodes."""

    def __init__(self, last=10**6, ends=lambda: os._exit(3)):
        self.acted, self.last, self.ends = 0, last, ends

    def reset(self, observation, info):
        pass

    def act(self, observation):
        self.acted += 1
        if self.acted > self.last:
            self.ends()
        return np.array([os.getpid(), self.acted])


@pytest.fixture
def process():
    """Makes the process of a policy, and closes it."""
    made = []

    def make(*arguments, **others):
        made.append(PolicyProcess(lambda: Counts(*arguments, **others)))
        made[-1].reset(SEEN, {})
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_a_policy_that_is_made_anew_stays_in_its_process_and_forgets_what_it_did(process):
    policy = process()
    (pid, _), (same, twice) = policy.act(SEEN), policy.act(SEEN)
    assert pid == same != os.getpid()
    assert twice == 2
    policy.renew()
    policy.reset(SEEN, {})
    assert policy.act(SEEN).tolist() == [pid, 1]


@pytest.mark.parametrize(("ends", "said"), [
    (lambda: os._exit(3), "the policy has ended: exit status 3"),
    (lambda: 1 / 0, "the policy raised ZeroDivisionError"),
])
def test_after_it_has_ended_another_process_has_it(process, ends, said):
    policy = process(1, ends)
    pid, _ = policy.act(SEEN)
    with pytest.raises(Stopped, match=said):
        policy.act(SEEN)
    policy.renew()
    policy.reset(SEEN, {})
    other, count = policy.act(SEEN)
    assert other != pid
    assert count == 1


def test_one_that_hangs_is_replaced_as_well(process):
    policy = process(0, lambda: time.sleep(1000.0))
    assert policy.ask(SEEN, 0.05) is None
    policy.renew()  # does not wait for the answer


def test_what_it_is_refused_for_is_all_that_is_said():
    def make():
        raise ValueError("of another task")

    with pytest.raises(Stopped) as stopped:
        PolicyProcess(make)
    assert f"{stopped.value}" == "of another task"
