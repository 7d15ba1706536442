"""All that runs around the physics steps compiles for a GPU, none being there."""

import importlib.util
import re

import pytest

from servogym.drive.kernel.record import AXIS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("numba_cuda") is None,
        reason="no numba-cuda: pip install 'servogym[gpu]'",
    ),
]


@pytest.mark.parametrize(
    ("part", "lines"),
    {
        "begin": 300,
        "control": 10_000,
        "forces": 300,
        "stick": 300,
        "finish": 300,
        "end": 300,
    }.items(),
)
def test_each_part_of_a_step_compiles_to_ptx_for_a_gpu(part, lines):
    from servogym.envs.engine import gpu

    text = gpu.ptx(part)
    assert re.search(r"^\.target sm_90$", text, re.M)
    assert len(re.findall(r"^\.visible \.entry", text, re.M)) == 1
    assert ".extern" not in text, "all it calls is in it"
    assert len(text.splitlines()) > lines, "the whole of it, not a stub"
    if part == "control":
        fields = [int(at) for at in re.findall(r"ld\.[\w.]+\s+\S+ \[%rd\d+\+(\d+)\]", text)]
        assert 0.9 * AXIS.itemsize < max(fields) < AXIS.itemsize, "the record, and nothing beyond"
