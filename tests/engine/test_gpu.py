"""All that runs around the physics steps compiles for a GPU, none being there: drives and tasks."""

import contextlib
import importlib.util
import re
import sys
import types

import numba
import numpy as np
import pytest

from servogym.drive.kernel.record import AXIS, accessible
from servogym.drive.memory import address, integers_at
from servogym.envs import TASKS
from servogym.envs.engine import gpu
from servogym.envs.engine.rows import aligned
from servogym.envs.engine.world import MOVE
from servogym.envs.engine.worlds import _row
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.exchange import faces
from servogym.envs.exchange.loops import acting, judging
from servogym.envs.tasks.gantry_sync import GantrySyncEnv

without_numba_cuda = pytest.mark.skipif(
    importlib.util.find_spec("numba_cuda") is None,
    reason="no numba-cuda: pip install 'servogym[gpu]'",
)
thread = np.zeros(1, np.int64)  # which one a kernel believes to be
THREAD = address(thread)


@numba.njit
def grid(dimensions):
    return integers_at(THREAD, 1)[0]


def on_a_cpu(kernel):
    """A kernel of a GPU as a function of the CPU, thread after thread."""
    cuda = types.ModuleType("cuda")
    cuda.grid = grid
    compiled = numba.njit(kernel.make(cuda))

    def run(*arguments):
        for i in range(arguments[-1] + 1):  # one too many, as the last block has
            thread[0] = i
            compiled(*arguments)

    return run


def test_the_kernels_of_a_task_do_what_its_functions_do_on_a_cpu():
    vector = ServoVectorEnv(GantrySyncEnv, 3, threads=1)
    vector.reset(seed=1)
    env, batch = vector.envs[0], vector._batch
    rpdo, tpdo = map(aligned, env._images)
    n = len(env.drives)
    batch.actions[:] = np.random.default_rng(1).uniform(-1, 1, batch.actions.shape)
    rpdos, tpdos = np.zeros((3, n), accessible(rpdo)), np.zeros((3, n), accessible(tpdo))
    for even, packed in ((rpdos, batch.rpdos), (tpdos, batch.tpdos)):
        for name in even.dtype.names:
            even[name] = packed[name]
    worlds, episodes = batch.worlds.copy(), batch.episodes.copy()
    worlds[1] = 0
    before = episodes[1].copy(), rpdos[1].copy()
    episode, seen = env.EPISODE, np.zeros_like(batch._seen)
    seen[1] = batch._seen[1]
    act = on_a_cpu(gpu.of_act(acting(env.act), n, episode, env.ACTION, rpdo))
    act(*map(address, (worlds, episodes, batch._commands, rpdos)), 3)
    judge = on_a_cpu(gpu.of_judge(judging(env.judge), n, episode, rpdo, tpdo, env.OBSERVATION))
    judge(*map(address, (worlds, episodes, rpdos, tpdos, seen)), 3)
    assert episodes[1] == before[0], "left out"
    assert (rpdos[1] == before[1]).all()
    acting(env.act)(worlds, batch.episodes, batch._commands, batch.rpdos)
    judging(env.judge)(worlds, batch.episodes, batch.rpdos, batch.tpdos, batch._seen)
    assert (batch.rpdos["target_position"][[0, 2]] != 0).any()
    for own, its in ((episodes, batch.episodes), (rpdos, batch.rpdos), (seen, batch._seen)):
        for name in own.dtype.names:
            np.testing.assert_array_equal(own[name], its[name])


@pytest.mark.slow
@without_numba_cuda
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
def test_each_part_of_a_step_compiles_for_a_gpu(part, lines):
    text = gpu.ptx(gpu.of_part(part))
    assert re.search(r"^\.target sm_90$", text, re.M)
    assert len(re.findall(r"^\.visible \.entry", text, re.M)) == 1
    assert ".extern" not in text, "all it calls is in it"
    assert len(text.splitlines()) > lines, "the whole of it, not a stub"
    assert gpu.machine_code(text).startswith(b"\x7fELF")
    if part == "control":
        fields = [int(at) for at in re.findall(r"ld\.[\w.]+\s+\S+ \[%rd\d+\+(\d+)\]", text)]
        assert 0.9 * AXIS.itemsize < max(fields) < AXIS.itemsize, "the record, and nothing beyond"


@pytest.mark.slow
@without_numba_cuda
@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.__name__)
def test_what_a_task_computes_compiles_for_a_gpu(task):
    from servogym.envs.engine import gpu

    env = task()
    rpdo, tpdo = map(aligned, env._images)
    n = len(env.drives)
    act = gpu.of_act(acting(env.act), n, env.EPISODE, env.ACTION, rpdo)
    judge = gpu.of_judge(judging(env.judge), n, env.EPISODE, rpdo, tpdo, env.OBSERVATION)
    for kernel in (act, judge):
        text = gpu.ptx(kernel)
        assert len(re.findall(r"^\.visible \.entry", text, re.M)) == 1
        assert ".extern" not in text, "all it calls is in it"
        assert gpu.machine_code(text).startswith(b"\x7fELF")


@pytest.mark.slow
@without_numba_cuda
def test_the_face_of_a_whole_master_compiles_for_a_gpu():
    env = GantrySyncEnv(action="pdo")
    rpdo, tpdo = map(aligned, env._images)
    modes, n = env._batch.modes, len(env.drives)
    for kernel in (
        gpu.of_control(faces.control, modes, n, faces.CONTROL, rpdo),
        gpu.of_report(faces.report, modes, n, tpdo, faces.STATUS),
    ):
        text = gpu.ptx(kernel)
        assert ".extern" not in text, "all it calls is in it"
        assert gpu.machine_code(text).startswith(b"\x7fELF")


@pytest.mark.slow
@without_numba_cuda
def test_machine_code_is_made_once_for_all_it_depends_on(tmp_path, monkeypatch):
    monkeypatch.setattr(gpu, "cache_directory", lambda: tmp_path)
    env = GantrySyncEnv()
    rpdo, n = aligned(env._images[0]), len(env.drives)
    fields = [(name, env.EPISODE[name]) for name in env.EPISODE.names]
    longer = np.dtype([*fields, ("more", "f8")], align=True)
    records = [(env.EPISODE, rpdo), (env.EPISODE, rpdo), (longer, rpdo)]
    made = [
        gpu.code(gpu.of_act(acting(env.act), n, episode, env.ACTION, images))
        for episode, images in records
    ]
    assert made[0] == made[1]
    assert gpu.ENTRY.encode() in made[0]
    assert len([*tmp_path.glob("*.cubin")]) == 2 == len([*tmp_path.iterdir()])
    kernel = gpu.of_act(acting(env.act), n, env.EPISODE, env.ACTION, rpdo)
    monkeypatch.setattr(gpu, "ptx", None)
    assert gpu.code(kernel) == made[0], "nothing is compiled"
    with pytest.raises(TypeError):
        gpu.code(kernel, (10, 0))


def astray(record, at=0, name=""):
    """Numbers of a record that do not lie at a multiple of their size."""
    kind = record.base
    if kind.names:
        inner = [(kind.fields[each], f"{name}.{each}") for each in kind.names]
        return [
            each for (field, place, *_), full in inner for each in astray(field, at + place, full)
        ]
    return [name] if at % kind.itemsize else []


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.__name__)
def test_a_gpu_finds_each_number_at_a_multiple_of_its_size(task):
    env = task()
    machine = _row(env.machine)
    assert machine.itemsize % 8 == env.EPISODE.itemsize % 8 == 0
    images = map(aligned, env._images)
    for record in (machine, env.EPISODE, env.ACTION, env.OBSERVATION, MOVE, *images):
        assert not astray(record)
        assert not astray(record, record.itemsize), "nor in the next row"
    assert astray(np.dtype([("a", "u1"), ("b", "f8")])) == [".b"]


def test_a_kernel_is_launched_with_a_thread_a_machine_and_its_addresses(monkeypatch):
    """On a driver that only takes note."""
    launched = []
    core = types.ModuleType("cuda.core")
    core.Device = lambda ordinal: types.SimpleNamespace(set_current=lambda: None)
    core.ObjectCode = types.SimpleNamespace(
        from_cubin=lambda made: types.SimpleNamespace(get_kernel=lambda name: (made, name))
    )
    core.LaunchConfig = lambda grid, block: (grid, block)
    core.Stream = types.SimpleNamespace(from_handle=lambda handle: handle)
    core.launch = lambda *given: launched.append(given)
    monkeypatch.setitem(sys.modules, "cuda.core", core)
    monkeypatch.setattr(gpu, "code", lambda kernel, capability: capability)
    device = types.SimpleNamespace(arch=100, ordinal=1, stream=types.SimpleNamespace(cuda_stream=5))
    wp = types.SimpleNamespace(ScopedDevice=lambda device: contextlib.nullcontext())
    gpu.launcher(wp, device, gpu.of_part("begin"), 129)(2**40, 4728)
    assert launched == [(5, (5, 32), ((10, 0), "servogym"), 2**40, 4728, 129)]


@pytest.mark.slow
@without_numba_cuda
def test_ptx_that_is_none_does_not_assemble():
    with pytest.raises(Exception, match="PTX_COMPILE"):
        gpu.machine_code(".version 8.0\n.target sm_90\n.entry nothing( {}")
