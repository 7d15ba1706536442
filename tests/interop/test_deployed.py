"""Tasks deployed to a server in another process: by udp_multicast, and by SOEM over veth."""

import re

import pytest
from deployed import BUSES, ENDINGS, HOSTILE, KILL, MOMENTS, REFERENCES, TASKS
from refusals import CASES, NOBODY
from wire import on_the_wire

SAMPLE = (
    "chatters 2", "NaN at 4", "words at 4", "raises SystemExit", "leaves at once", "kills itself",
    "holds the interpreter", "fills the memory", "creeps 0.2",
)


def over(bus, scenario, **arguments):
    if bus == "ethercat":
        pytest.importorskip("pysoem")
    return on_the_wire("deployed", scenario, "forked", bus=bus, **arguments)


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("task", TASKS)
def test_in_lock_step_with_another_process_observations_are_those_of_memory(task, bus):
    result = over(bus, "byte_equal", task=task)
    assert result["begins"] == 1
    assert result["equal"] == result["steps"], result
    assert result["lost"] == 0
    assert "OPERATION_ENABLED" not in result["states"]


def check(result, names):
    assert set(result["told"]) == set(names)
    for name, (reason, state, beyond, stands) in result["told"].items():
        assert re.search(HOSTILE[name][1], reason), (name, reason)
        assert state != "OPERATION_ENABLED", name
        assert beyond <= result["stopping"], name
        assert stands, name


@pytest.mark.parametrize("bus", BUSES)
def test_no_policy_gets_past_the_guard_on_the_wire(bus):
    check(over(bus, "hostile", names=SAMPLE), SAMPLE)


@pytest.mark.slow
@pytest.mark.parametrize("bus", BUSES)
def test_none_of_all_hostile_policies_does(bus):
    assert len(HOSTILE) >= 50
    check(over(bus, "hostile", names=[], timeout=600), HOSTILE)


@pytest.mark.parametrize(("bus", "clock"), [
    ("can", "real"), ("ethercat", "real"), ("ethercat", "dc"),
])
def test_in_real_time_an_episode_begins_on_each_clock_that_follows_it(bus, clock):
    def in_time(result):  # the drive's watchdog waits 0.1 or 0.2 s for this process
        return not result["stopped"]

    result = over(bus, "bring_up", clock=clock, in_time=in_time)
    assert result["stopped"] == ""
    assert result["state"] == "OPERATION_ENABLED"
    assert result["position"] == pytest.approx(result["believed"], abs=1e-3)
    assert result["after"] != "OPERATION_ENABLED"


@pytest.mark.parametrize(("bus", "says"), [
    ("ethercat", "x is in SAFE_OPERATIONAL: no frame came within the time of its watchdog"),
    ("can", "the connection to the master is lost"),
])
def test_a_master_that_was_held_up_on_the_way_to_the_start_is_told_so(bus, says):
    result = over(bus, "bring_up", clock="real", pause=0.4)
    assert result["stopped"].startswith("on the way to the start: ")
    assert says in result["stopped"]
    assert result["after"] != "OPERATION_ENABLED"


def check_endings(told):
    for name, row in told.items():
        moment, signals = ENDINGS[name]
        assert (row["before"] == "OPERATION_ENABLED") == (moment not in MOMENTS), (name, row)
        assert row["after"] != "OPERATION_ENABLED", (name, row)
        assert row["stands"], (name, row)
        assert "Traceback" not in row["said"], (name, row)
        if signals == (KILL,):
            assert row["status"] == -KILL, (name, row)
        elif moment in MOMENTS:
            assert row["status"] in (130, -signals[0]), (name, row)
        elif len(signals) == 1:
            assert row["status"] == 1, (name, row)
            assert "stopped: Ctrl-C" in row["said"], (name, row)
        else:  # the last one may end what is said about the stop, or meet Python at its end
            assert row["status"] in (1, 130, *(-number for number in signals)), (name, row)


@pytest.mark.parametrize("bus", BUSES)
def test_where_the_deploying_process_is_killed_or_interrupted_the_drive_stands(bus):
    told = over(bus, "ended", names=("killed", "twice in an episode"))
    assert len(told) == 2
    check_endings(told)


@pytest.mark.slow
@pytest.mark.parametrize("bus", BUSES)
def test_however_a_deployment_ends_the_drive_stands_and_there_is_no_traceback(bus):
    told = over(bus, "ended", names=[], timeout=600)
    assert set(told) == set(ENDINGS)
    check_endings(told)


def test_who_may_not_open_raw_sockets_reads_how_to_get_the_right():
    pytest.importorskip("pysoem")
    for words, (status, error) in on_the_wire("deployed", "without_rights", "forked").items():
        assert status == 2, (words, error)
        line, *others = error.splitlines()
        assert not others, (words, error)
        needed = "raw sockets need the capability CAP_NET_RAW: sudo setcap cap_net_raw+ep"
        assert needed in line, words


@pytest.mark.slow
@pytest.mark.parametrize("bus", BUSES)
def test_what_a_stranger_gets_wrong_is_refused_before_power_in_a_line_with_the_fix(bus):
    if bus == "ethercat":
        pytest.importorskip("pysoem")
    told = on_the_wire("refusals", "refusals", "forked", bus=bus, timeout=600)
    said = {case: words for case, (*_, buses, words) in CASES.items() if bus in buses}
    said["nobody"] = NOBODY[bus]
    assert told.keys() == said.keys()
    for case, row in told.items():
        assert row["status"] == 2, (case, row)
        (line,) = row["error"].splitlines()
        assert line.startswith("servogym deploy: "), case
        assert re.search(said[case], line), (case, line)
        assert {*row["states"]} <= {"NOT_READY_TO_SWITCH_ON", "SWITCH_ON_DISABLED"}, (case, row)


def same(bus, task, count):
    """Homed, moved to their starts and played: over the bus as in this process."""
    result = over(bus, "episodes", task=task, policy=REFERENCES[task], count=count, timeout=600)
    assert result["stopped"] == ""
    assert len(result["deployed"]) == count
    assert result["equal"] == result["steps"]
    late = [row.pop("late") for row in result["deployed"]]
    assert late == [0] * count
    assert result["deployed"] == result["memory"]


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("task", ["linear", "homing"])
def test_a_homing_the_ways_to_the_start_and_the_episodes_are_those_of_this_process(bus, task):
    same(bus, task, 2)


@pytest.mark.slow
@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("task", REFERENCES)
def test_long_series_are_those_of_this_process(bus, task):
    same(bus, task, 20)


@pytest.mark.slow
def test_the_log_of_a_deployment_becomes_a_twin():
    result = on_the_wire("deployed", "twin_of_log", "forked", timeout=600)
    assert result["status"] == [0, 0]
    low, high = result["found"]["payload"]
    assert low < result["true"]["payload"] < high < 1.1 * low
