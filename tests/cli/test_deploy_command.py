"""What `servogym deploy` refuses before there is a bus, in one line that says what to do."""

from pathlib import Path

import pytest

from servogym import assets

HERE = Path(assets.__file__).parent / "policies"
BUSES = {"can": ["-i", "socketcan", "-c", "nowhere0"], "ethercat": ["--ethercat", "nowhere0"]}


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


@pytest.mark.parametrize(("bus", "said"), [
    ("can", "no bus on --interface socketcan --channel nowhere0: "),
    ("ethercat", "interface nowhere0: "),
])
def test_a_bus_that_is_not_there_is_named(refused, bus, said):
    if bus == "ethercat":
        pytest.importorskip("pysoem")
    assert said in refused(["deploy", "LinearAxis-v0", "--yes", *BUSES[bus]])


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize(("limits", "said"), [
    ("y=0:1", "there is no drive 'y' of x"), ("x=0", "give LOW:HIGH, as x=0.05:0.4"),
])
def test_limits_that_are_none_are_refused_before_the_bus_is_opened(refused, bus, limits, said):
    error = refused(["deploy", "LinearAxis-v0", "--limits", limits, "--yes", *BUSES[bus]])
    assert f"--limits {limits}: {said}" in error
