"""All that runs around the physics steps compiles for a GPU, none being there: drives and tasks."""

import importlib.util
import re

import pytest

from servogym.drive.kernel.record import AXIS
from servogym.envs import TASKS

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

    text = gpu.ptx(gpu.of_part(part))
    assert re.search(r"^\.target sm_90$", text, re.M)
    assert len(re.findall(r"^\.visible \.entry", text, re.M)) == 1
    assert ".extern" not in text, "all it calls is in it"
    assert len(text.splitlines()) > lines, "the whole of it, not a stub"
    if part == "control":
        fields = [int(at) for at in re.findall(r"ld\.[\w.]+\s+\S+ \[%rd\d+\+(\d+)\]", text)]
        assert 0.9 * AXIS.itemsize < max(fields) < AXIS.itemsize, "the record, and nothing beyond"


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.__name__)
def test_what_a_task_computes_compiles_to_ptx_for_a_gpu(task):
    from servogym.envs.engine import gpu
    from servogym.envs.engine.worlds import aligned

    env = task()
    rpdo, tpdo = map(aligned, env._images)
    n = len(env.drives)
    act = gpu.of_act(env.act, env.EPISODE, env.ACTION, rpdo, n)
    judge = gpu.of_judge(env.judge, env.EPISODE, rpdo, tpdo, n, env.OBSERVATION)
    for kernel in (act, judge):
        text = gpu.ptx(kernel)
        assert len(re.findall(r"^\.visible \.entry", text, re.M)) == 1
        assert ".extern" not in text, "all it calls is in it"
