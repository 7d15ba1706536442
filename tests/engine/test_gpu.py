"""The whole drive compiles for a GPU, none being there."""

import importlib.util
import re

import pytest

from servogym.drive.kernel.record import AXIS


@pytest.mark.slow
def test_the_velocity_cycle_compiles_to_ptx_for_a_gpu():
    if importlib.util.find_spec("numba_cuda") is None:
        pytest.skip("no numba-cuda: pip install 'servogym[gpu]'")
    from servogym.envs.engine import gpu

    text = gpu.ptx()
    assert re.search(r"^\.target sm_90$", text, re.M)
    assert ".extern" not in text, "all it calls is in it"
    assert len(text.splitlines()) > 10_000, "the whole drive, not a stub of it"
    fields = [int(offset) for offset in re.findall(r"ld\.[\w.]+\s+\S+ \[%rd\d+\+(\d+)\]", text)]
    assert 0.9 * AXIS.itemsize < max(fields) < AXIS.itemsize, "the record, and nothing beyond"
