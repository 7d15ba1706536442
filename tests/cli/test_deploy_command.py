"""What `servogym deploy` refuses before there is a bus, in one line that says what to do."""

import json
import shutil
from pathlib import Path

import pytest

from servogym import assets
from servogym.drive.wire import soem

HERE = Path(assets.__file__).parent / "policies"
BUSES = {"can": ["-i", "socketcan", "-c", "nowhere0"], "ethercat": ["--ethercat", "nowhere0"]}


@pytest.fixture
def permitted(monkeypatch):
    """The interface may be opened, as far as is known before: only opening it finds it missing."""
    monkeypatch.setattr(soem, "check_access", lambda interface: None)


@pytest.mark.usefixtures("permitted")
@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize(("policy", "said"), [
    ("search", "policy 'search' is for servogym/Homing-v0: for servogym/LinearAxis-v0 choose of"),
    (f"{HERE / 'LinearAxisTracking-v0'}", "servogym/LinearAxisTracking-v0"),
    ("nobody", "policy 'nobody' is unknown for servogym/LinearAxis-v0"),
    ("iterative_learning", "no bus tells it"),
])
def test_a_policy_of_another_task_is_refused_before_the_bus_is_opened(refused, bus, policy, said):
    error = refused(["deploy", "LinearAxis-v0", "--policy", policy, "--yes", *BUSES[bus]])
    assert f"--policy {policy}: " in error
    assert said in error
    assert "nowhere0" not in error


def _cut(folder):
    weights = folder / "weights.npz"
    weights.write_bytes(weights.read_bytes()[: weights.stat().st_size // 2])


def _one_bit(folder):
    data = bytearray((folder / "weights.npz").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "weights.npz").write_bytes(data)


def _of_another(folder):
    shutil.copy(HERE / "LinearAxis-v0/seed_2/weights.npz", folder / "weights.npz")


def _without_a_key(folder):
    card = folder / "checkpoint.json"
    card.write_text(json.dumps({k: v for k, v in json.loads(card.read_text()).items()
                                if k != "algorithm"}))


def _of_the_tracking_task(folder):
    shutil.rmtree(folder)
    shutil.copytree(HERE / "LinearAxisTracking-v0/seed_1", folder)


DAMAGES = {
    "half of the weights": (_cut, "policy/weights.npz holds no arrays that can be read"),
    "a bit of the weights": (_one_bit, "policy/weights.npz holds no arrays that can be read"),
    "weights of another training": (_of_another, "weights.npz was changed or damaged: its SHA-256"),
    "no weights": (lambda it: (it / "weights.npz").unlink(), "policy has no weights.npz"),
    "no card": (lambda it: (it / "checkpoint.json").unlink(), "policy is not a checkpoint"),
    "half of the card": (
        lambda it: (it / "checkpoint.json").write_text('{"env_id": '), "checkpoint.json is damaged"
    ),
    "a card without a key": (_without_a_key, "checkpoint.json lacks algorithm"),
    "of another task": (
        _of_the_tracking_task,
        "was trained for servogym/LinearAxisTracking-v0, not for servogym/LinearAxis-v0",
    ),
    "an empty folder": (lambda it: [each.unlink() for each in it.iterdir()],
                        "policy is not a checkpoint"),
    "no folder": (shutil.rmtree, "is unknown for servogym/LinearAxis-v0"),
}


@pytest.mark.usefixtures("permitted")
@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_policy_is_refused_before_the_bus_is_opened(refused, bus, damage, tmp_path):
    harm, said = DAMAGES[damage]
    folder = tmp_path / "policy"
    shutil.copytree(HERE / "LinearAxis-v0/seed_1", folder)
    harm(folder)
    error = refused(["deploy", "LinearAxis-v0", "--policy", f"{folder}", "--yes", *BUSES[bus]])
    assert f"--policy {folder}: " in error
    assert said in error
    assert "nowhere0" not in error


@pytest.mark.parametrize(("bus", "said"), [
    ("can", "no bus on --interface socketcan --channel nowhere0: "),
    ("ethercat", "interface nowhere0 does not exist: choose one of "),
])
def test_a_bus_that_is_not_there_is_named(refused, bus, said):
    if bus == "ethercat":
        pytest.importorskip("pysoem")
    assert said in refused(["deploy", "LinearAxis-v0", "--yes", *BUSES[bus]])


@pytest.mark.usefixtures("permitted")
@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize(("limits", "said"), [
    ("y=0:1", "there is no drive 'y' of x"), ("x=0", "give LOW:HIGH, as x=0.05:0.4"),
])
def test_limits_that_are_none_are_refused_before_the_bus_is_opened(refused, bus, limits, said):
    error = refused(["deploy", "LinearAxis-v0", "--limits", limits, "--yes", *BUSES[bus]])
    assert f"--limits {limits}: {said}" in error
