"""The bench of vectors: who is asked how often, and what is told."""

from contextlib import ExitStack
from itertools import islice

import pytest

from servogym.training.bench import Peer, rates, vectors


def test_blocks_alternate_after_one_for_warming_up():
    calls = []
    peers = [
        Peer(name, "", n, lambda name=name: calls.append(name), lambda: calls.append("|"))
        for name, n in (("a", 2), ("b", 1))
    ]
    first, second = rates(peers, 2, 1)
    assert "".join(calls) == "|aa|bb|aa|bb"
    assert first["ours_over"] == 1.0
    assert second["ours_over"] == pytest.approx(first["per_s"] / second["per_s"])


def test_the_rows_step_what_they_say():
    (drive,) = islice(vectors.drives("generic"), 1)
    assert drive.what.endswith("CYCLIC_SYNC_POSITION")
    torque = [drive.step() for _ in range(100)][-1]  # Nm; of a drive without a mode it is 0
    assert -1.0 < torque < 0.0, "the controllers turn it back"
    with ExitStack() as stack:
        ours, sync = islice(vectors.vectors("generic", stack), 2)
        for peer, n in ((ours, vectors.MANY), (sync, vectors.FEW)):
            peer.restart()
            assert peer.envs == n == len(peer.step()[1])
