"""Jobs on Ray: equal results on one machine and on two nodes, whatever is killed meanwhile."""

import os
import socket
import time

import deeds
import pytest
from later import Later, only_with

from servogym.training import cli
from servogym.training.evaluate.comparison import evaluate
from servogym.training.scale import cluster, job
from servogym.training.scale.job import Job, encoded
from servogym.training.scale.work import ALONE, Work

ray = Later("ray")
pytestmark = only_with("ray", reason="pip install 'servogym[ray]'")


@pytest.fixture(scope="module")
def two_nodes():
    """A cluster of two nodes with one core each, on this machine -> its address."""
    from ray.cluster_utils import Cluster

    os.environ["PYTHONPATH"] = os.path.dirname(__file__)  # where workers find deeds.py
    found = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    found.add_node(num_cpus=1)
    yield found.address
    found.shutdown()
    del os.environ["PYTHONPATH"]


def test_an_address_where_nobody_answers_is_one_line(refused):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    begin = time.monotonic()
    command = ["eval", "LinearAxis-v0", "--policy", "hold", "--episodes", "1", "--ray", address]
    assert f"--ray {address}: nobody answers there" in refused(command)
    assert time.monotonic() - begin < 6 * cluster.SECONDS


def test_an_address_that_is_none_is_one_line():
    with pytest.raises(ValueError, match=r"'here' is not an address: give HOST:PORT"):
        Work(ray="here").map([Job("", deeds.square, {"x": 1})])


@pytest.mark.slow
def test_what_answers_and_is_no_cluster_is_given_up(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT", 5.0)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        address = f"127.0.0.1:{mute.getsockname()[1]}"
        with pytest.raises(ValueError, match=f"--ray {address}: "):
            Work(ray=address).map([Job("", deeds.square, {"x": 1})])


@pytest.mark.slow
def test_two_nodes_give_the_same_bytes_and_a_killed_worker_loses_nothing(two_nodes, tmp_path):
    work = Work(ray=two_nodes)
    todo = [Job(f"job {x}", deeds.square, {"x": x}) for x in range(5)]
    found = work.map(todo, warm=todo[:1])
    assert [encoded(result) for result in found] == [encoded(result) for result in ALONE.map(todo)]
    todo = [Job(f"job {x}", deeds.killed, {"x": x, "folder": str(tmp_path)}) for x in range(4)]
    assert [result["x"] for result in work.map(todo)] == [0, 1, 2, 3]
    assert len([*tmp_path.glob("once*")]) == 2
    with pytest.raises(ValueError, match=r"x = 1 is out of range"):
        work.map([Job("", deeds.counted, {"x": 1, "folder": str(tmp_path), "fails": (1,)})])
    todo = [Job("job", deeds.killed, {"x": 0, "folder": str(tmp_path), "always": True})]
    with pytest.raises(RuntimeError, match=r"job: WorkerCrashedError"):
        work.map(todo)


@pytest.mark.slow
def test_episodes_of_two_nodes_are_the_episodes(two_nodes):
    arguments = ("LinearAxis-v0", ["ruckig", "random"], "generic", 11, 0)
    for one, other in zip(
        evaluate(*arguments), evaluate(*arguments, work=Work(ray=two_nodes)), strict=True
    ):
        for name, values in one.values.items():
            assert values.tobytes() == other.values[name].tobytes(), name


@pytest.mark.slow
def test_a_node_of_another_version_is_refused_with_both_named(two_nodes, monkeypatch):
    own = job.stamp()
    for module in (job, cluster):
        monkeypatch.setattr(module, "stamp", lambda: "servogym 9.9")
    with pytest.raises(RuntimeError) as told:
        Work(ray=two_nodes).map([Job("", deeds.square, {"x": 1})])
    assert f"has {own}, this is servogym 9.9" in str(told.value)


@pytest.mark.slow
def test_a_command_starts_its_own_cluster_and_its_files_are_the_same(tmp_path):
    command = ["compare", "LinearAxis-v0", "--policies", "hold,ruckig", "--episodes", "11"]
    assert cli.main([*command, "--out", str(tmp_path / "alone")]) == 0
    ray_too = ["--ray", "--workers", "2", "--out", str(tmp_path / "ray")]
    assert cli.main([*command, *ray_too]) == 0
    assert not ray.is_initialized()
    for file in (tmp_path / "alone").iterdir():
        assert file.read_bytes() == (tmp_path / "ray" / file.name).read_bytes(), file.name
