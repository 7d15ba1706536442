"""A served machine: foreign masters move it, and a test sees its true state beside the bus."""

import re
import signal
import socket
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import can
import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from servogym.drive.canopen.eds import object_dictionary
from servogym.drive.ethercat.frame import UDP_PORT
from servogym.envs.serve.description import read
from servogym.envs.serve.laboratory import Laboratory

pytest_plugins = ["servogym.testing"]


def feeder(channel, **bus):
    return {
        "bus": {"can": {"kind": "can", "interface": "virtual", "channel": channel} | bus},
        "machine": {"feeder": {"bus": "can", "axis": "linear", "node_id": 5}},
    }


@pytest.fixture
def network(request):
    """A CANopen network of the library on a virtual channel named after the test."""
    network = canopen.Network()
    network.connect(interface="virtual", channel=request.node.name)
    yield network
    network.disconnect()


def enabled(network, node_id=5):
    node = BaseNode402(node_id, object_dictionary("generic", node_id))
    network.add_node(node)
    node.nmt.state = "PRE-OPERATIONAL"
    node.sdo[0x1800][5].raw = 20  # ms
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        node.state = state
    return node


def test_a_foreign_master_enables_and_a_fault_of_the_script_and_one_of_the_test_stop_it(
    laboratory, network, request
):
    rows = feeder(request.node.name)
    rows["machine"]["feeder"]["parameters"] = {"payload": 12.0, "mechanics": "ball_screw"}
    machine = laboratory(rows)
    enabled(network)
    assert machine.state("feeder") == "OPERATION_ENABLED"
    machine.inject("feeder.x", "overvoltage")
    machine.wait_until(lambda: machine.state("feeder.x") == "FAULT")
    assert machine.fault("feeder").startswith("3210h")


def test_the_true_position_is_that_of_the_joint_and_a_push_moves_it(laboratory, request):
    rows = feeder(request.node.name)
    rows["machine"]["feeder"]["positions"] = {"x": 0.2}
    machine = laboratory(rows)
    assert machine.position("feeder.x") == pytest.approx(0.2, abs=1e-6)
    machine.push("feeder.x", 300.0)  # N, against a drive without power
    machine.advance(0.05)
    assert machine.position("feeder.x") > 0.21
    assert machine.velocity("feeder.x") > 0.1
    machine.reset("feeder", x=0.3)
    assert machine.position("feeder.x") == pytest.approx(0.3, abs=1e-6)


def test_an_object_that_a_boot_resets_is_refused_in_the_file(request):
    rows = feeder(request.node.name)
    rows["machine"]["feeder"]["write"] = {"x": {"cob_id_sync": 0x81}}
    with pytest.raises(ValueError, match="feeder: write: cob_id_sync belongs to"):
        Laboratory(rows)


def test_time_of_a_real_bus_follows_the_clock_and_advance_runs_ahead(laboratory, request):
    machine = laboratory(feeder(request.node.name))
    begin, start = machine.time("feeder"), time.monotonic()
    machine.advance(5.0)
    assert machine.time("feeder") - begin >= 5.0
    machine.wait_until(lambda: machine.time("feeder") - begin > 5.1)
    assert time.monotonic() - start < 5.0, "the five seconds took none"


def test_on_the_clock_sync_two_runs_of_a_master_are_equal_and_events_come_at_their_time(
    laboratory, request
):
    def run(channel):
        rows = feeder(channel, clock="sync", period_us=1000)
        rows["event"] = [
            {"at": 0.02, "drive": "feeder", "inject": "overvoltage", "clear_after": 0.01}
        ]
        machine = laboratory(rows)
        bus = can.Bus(interface="virtual", channel=channel)
        seen = []
        try:
            for cycle in range(1, 41):
                bus.send(can.Message(arbitration_id=0x80, is_extended_id=False))
                machine.wait_until(lambda n=cycle: round(machine.time("feeder") * 1e3) >= n)
                seen.append((round(machine.time("feeder") * 1e3), machine.state("feeder")))
        finally:
            bus.shutdown()
        return seen

    first, second = run(request.node.name), run(request.node.name + "2")
    assert first == second
    assert [ms for ms, _ in first] == list(range(1, 41)), "a millisecond a SYNC"
    faulty = [ms for ms, state in first if state == "FAULT"]
    assert 20 < faulty[0] <= 22


def test_a_reset_is_a_power_cycle_with_a_boot_up_and_unstored_parameters_lost(
    laboratory, network, request
):
    machine = laboratory(feeder(request.node.name))
    node = enabled(network)
    shipped = node.sdo["following_error_window"].raw
    node.sdo["following_error_window"].raw = 77
    booted = []
    network.subscribe(0x705, lambda *frame: booted.append(frame))
    machine.reset()
    machine.wait_until(lambda: bool(booted))
    assert machine.state("feeder") == "SWITCH_ON_DISABLED"
    assert node.sdo["following_error_window"].raw == shipped


def test_a_snapshot_continues_where_it_was(laboratory, request):
    machine = laboratory(feeder(request.node.name, clock="sync"))
    kept = machine.snapshot("feeder")
    machine.push("feeder", 200.0)
    machine.advance(0.1)
    moved = machine.position("feeder")
    machine.restore("feeder", kept)
    assert machine.position("feeder") == pytest.approx(0.12)
    assert moved > 0.13


def test_machines_on_two_buses_are_served_side_by_side(laboratory, request):
    rows = feeder(request.node.name)
    rows["bus"]["line"] = {"kind": "ethercat", "udp": "127.0.0.7", "clock": "frame"}
    rows["machine"]["lift"] = {"bus": "line", "axis": "vertical", "drive": "kollmorgen_akd"}
    machine = laboratory(rows)
    assert sorted(machine.drives) == ["feeder.x", "lift.x"]
    read_al_status = bytes.fromhex("0e10 07 01 00003001 0200 0000 0000 0000")  # BRD 0130h
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.settimeout(5.0)
        udp.sendto(read_al_status, ("127.0.0.7", UDP_PORT))
        answer = udp.recv(1500)
    assert answer[-2:] == b"\1\0", "working counter: one slave read"
    assert answer[12] & 0x0F == 1  # INIT
    machine.reset("lift", x=0.3)
    assert machine.position("lift") == pytest.approx(0.3, abs=1e-4)


def test_a_robot_of_ones_own_and_objects_written_before_it_is_served(laboratory, request, tmp_path):
    (tmp_path / "arm.xml").write_text(
        "<mujoco><worldbody><body><joint name='hip' type='hinge' range='-90 90'/>"
        "<geom type='capsule' fromto='0 0 0 .3 0 0' size='.03'/></body></worldbody></mujoco>"
    )
    (tmp_path / "machine.toml").write_text(f"""
        [bus.can]
        kind = "can"
        interface = "virtual"
        channel = "{request.node.name}"

        [machine.arm]
        bus = "can"
        mjcf = "arm.xml"
        drive = {{ hip = "generic" }}
        node_id = 9
        write = {{ hip = {{ following_error_window = 4321 }} }}
    """)
    machine = laboratory(tmp_path / "machine.toml")
    assert machine.do("arm", lambda m: m.drives["hip"].read("following_error_window")) == 4321
    assert machine.drives["arm.hip"].node_id == 9


CAN = {"kind": "can", "interface": "virtual", "channel": "refused"}
AXIS = {"bus": "can", "axis": "linear", "node_id": 1}


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ({}, "there is no machine"),
        ({"machnie": {}}, "did you mean machine"),
        ({"machine": {"x": AXIS}}, "bus = 'can'"),
        ({"bus": {"can": CAN | {"kind": "profinet"}}, "machine": {"x": AXIS}}, "can, ethercat"),
        ({"bus": {"can": CAN | {"clock": "frame"}}, "machine": {"x": AXIS}}, "real, sync"),
        ({"bus": {"can": CAN | {"chanel": 1}}, "machine": {"x": AXIS}}, "did you mean channel"),
        ({"bus": {"can": CAN}, "machine": {"x": AXIS | {"node_id": 0}}}, "out of range 1..127"),
        ({"bus": {"can": CAN}, "machine": {"x": AXIS | {"node_id": "5"}}}, "must be int"),
        ({"bus": {"can": CAN}, "machine": {"x": AXIS | {"axis": "liner"}}}, "did you mean linear"),
        ({"bus": {"can": CAN}, "machine": {"x": AXIS | {"mjcf": "a.xml"}}}, "axis, a kind"),
        (
            {"bus": {"can": CAN}, "machine": {"x": AXIS | {"parameters": {"payload": -1}}}},
            "payload = -1",
        ),
        (
            {"bus": {"can": CAN}, "machine": {"x": AXIS | {"parameters": {"pay_load": 1}}}},
            "pay_load",
        ),
        (
            {"bus": {"can": CAN}, "machine": {"x": AXIS | {"drive": "genric"}}},
            "did you mean generic",
        ),
        (
            {
                "bus": {"can": CAN},
                "machine": {"x": AXIS},
                "event": [{"at": 1, "drive": "x", "inject": "overvoltag"}],
            },
            "did you mean overvoltage",
        ),
        (
            {
                "bus": {"can": CAN},
                "machine": {"x": AXIS},
                "event": [{"at": -1, "drive": "x", "inject": "overvoltage"}],
            },
            "at = -1",
        ),
        ({"bus": {"can": CAN | {"faults": {"drop": 2.0}}}, "machine": {"x": AXIS}}, "drop = 2.0"),
        ({"bus": {"can": CAN | {"faults": {"dorp": 0.1}}}, "machine": {"x": AXIS}}, "mean drop"),
        ({"bus": {"can": CAN | {"faults": ["drop"]}}, "machine": {"x": AXIS}}, "give a table"),
        (
            {"bus": {"can": CAN | {"options": {"preserve_timestamp": 1}}}, "machine": {"x": AXIS}},
            "mean preserve_timestamps",
        ),
        (
            {"bus": {"can": CAN | {"interface": "nosuch"}}, "machine": {"x": AXIS}},
            "nosuch",
        ),
    ],
)
def test_what_is_wrong_in_a_machine_file_is_named_in_a_line(rows, said):
    with pytest.raises(ValueError, match=said) as raised:
        Laboratory(rows).start()
    assert "\n" not in str(raised.value)


def test_two_nodes_with_one_number_on_a_bus_are_refused():
    rows = {"bus": {"can": CAN}, "machine": {"a": AXIS, "b": AXIS}}
    with pytest.raises(ValueError, match=r"node-id 1 is that of a\.x and b\.x"):
        Laboratory(rows)


def test_what_ends_a_bus_is_raised_where_the_test_looks(request):
    laboratory = Laboratory(feeder(request.node.name)).start()
    laboratory._threads["can"].bus.serve = lambda: 1 / 0
    with pytest.raises(ZeroDivisionError):
        laboratory.wait_until(lambda: False)
    laboratory.stop()


def test_the_command_serves_the_file_of_the_page_and_ends_by_a_signal(tmp_path):
    page = (Path(__file__).parents[2] / "docs/how-to/serve.md").read_text(encoding="utf-8")
    block = next(part.partition("```")[0] for part in page.split("```toml\n")[1:])
    (tmp_path / "machine.toml").write_text(block.replace("239.74.163.2", "239.74.163.77"))
    assert read(tmp_path / "machine.toml").machines == read(tomllib.loads(block)).machines
    command = [sys.executable, "-m", "servogym.training.cli", "serve", "machine.toml"]
    checked = subprocess.run([*command, "--check"], cwd=tmp_path, capture_output=True, text=True)
    assert (checked.returncode, checked.stderr) == (0, "")
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert "clock real" in process.stdout.readline()
        finally:
            process.terminate()
        assert process.wait(20) == 0


@pytest.mark.slow
def test_the_test_of_the_page_passes_as_it_is_printed(tmp_path):
    page = (Path(__file__).parents[2] / "docs/how-to/serve.md").read_text(encoding="utf-8")
    page = page.replace("239.74.163.2", "239.74.163.78")
    files = {
        "machine.toml": re.search(r"^```toml\n(.*?)^```", page, re.M | re.S)[1],
        "test_feeder.py": re.search(r"^:caption: test_feeder.py\n(.*?)^```", page, re.M | re.S)[1],
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    commands = re.findall(r"^(servogym eds .*|python -m pytest .*)$", page, re.M)
    assert len(commands) == 2
    for command in commands:
        words = command.replace("servogym", "-m servogym.training.cli").replace("python ", "")
        done = subprocess.run(
            [sys.executable, *words.split()], cwd=tmp_path, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert "2 passed" in done.stdout


def test_on_a_bad_bus_frames_are_lost_and_the_master_asks_again(laboratory, network, request):
    machine = laboratory(feeder(request.node.name, faults={"drop": 0.1}))
    node = network.add_node(5, object_dictionary("generic", 5))
    # an answer later than this, on a busy computer, is taken for that to the next request
    node.sdo.MAX_RETRIES, node.sdo.RESPONSE_TIMEOUT = 20, 0.25
    for value in range(1000, 1060):
        node.sdo["following_error_window"].raw = value
        assert node.sdo["following_error_window"].raw == value
    assert machine.servers["can"].bus.counts["drop"] > 12


def test_a_drive_whose_motor_is_held_is_served_and_has_no_place(laboratory, network, request):
    rows = feeder(request.node.name)
    rows["machine"]["feeder"]["axis"] = "none"
    machine = laboratory(rows)
    assert enabled(network).statusword & 0x6F == 0x27
    with pytest.raises(ValueError, match="its motor is held"):
        machine.position("feeder.x")
    machine.reset()
    assert machine.state("feeder.x") == "SWITCH_ON_DISABLED"


BOTH = """
[bus.can]
kind = "can"
interface = "virtual"
channel = "ended"
[bus.line]
kind = "ethercat"
udp = "127.0.0.9"
clock = "real"
[machine.feeder]
bus = "can"
axis = "linear"
node_id = 1
[machine.lift]
bus = "line"
axis = "vertical"
"""
INT, TERM = signal.SIGINT, signal.SIGTERM


@pytest.mark.parametrize(("moment", "signals"), [
    ("serving", (INT, INT)),
    pytest.param("serving", (INT,), marks=pytest.mark.slow),
    pytest.param("serving", (TERM, INT, TERM), marks=pytest.mark.slow),
    pytest.param("numpy", (INT,), marks=pytest.mark.slow),
    pytest.param("mujoco", (INT, INT), marks=pytest.mark.slow),
    pytest.param("mujoco", (TERM,), marks=pytest.mark.slow),
])
def test_however_serving_ends_there_is_no_traceback(tmp_path, moment, signals):
    (tmp_path / "machine.toml").write_text(BOTH)
    command = [sys.executable, "-m", "servogym.training.cli", "serve", "machine.toml"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(INT, signal.default_int_handler),
    ) as process:
        if moment == "serving":
            assert "can on virtual" in process.stdout.readline()
        else:
            until = time.monotonic() + 30
            while moment not in Path(f"/proc/{process.pid}/maps").read_text():
                assert time.monotonic() < until
                time.sleep(1e-3)
        for number in signals:
            process.send_signal(number)
            time.sleep(0.02)
        said, errors = process.communicate(timeout=30)
    assert "Traceback" not in errors
    if moment == "serving":
        # a further SIGTERM may meet Python at its end, which has no handlers any more
        assert process.returncode in {0, *([-TERM] if signals[2:] else [])}
        assert errors == ""
        assert "deadlines missed" in said
    else:
        assert process.returncode in (130, -signals[0])
