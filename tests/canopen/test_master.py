"""The master's helpers against the node in one process, by SDO and by PDO, in simulated time."""

import random
import struct

import pytest

from servogym.drive.canopen.frame import Frame, parse
from servogym.drive.canopen.node import NmtCommand, NmtState, Node
from servogym.drive.canopen.port import NodePort
from servogym.drive.canopen.remote import CanOpenPort
from servogym.drive.canopen.sdo_client import SdoClient
from servogym.drive.drive import Drive
from servogym.drive.kernel.words import Mode, State
from servogym.drive.master import (
    BusError,
    DriveFault,
    HomingFailed,
    Master,
    NoPower,
    Refused,
    ServoError,
    Timeout,
)
from servogym.drive.objects.abort import Abort, SdoAbort
from servogym.envs import linear_axis

TURN = 1_048_576  # increments
WINDOW = 1456  # increments, 6067h
STANDSTILL = 1.0  # rad/s, about 606Fh


class Bench:
    """A shaft, its node, and a master of it; every frame is kept."""

    def __init__(self, shaft, pdo=False):
        self.shaft = shaft
        self.drive = shaft.drive
        self.drive.write("following_error_window", TURN)
        self.node = Node(self.drive)
        port = NodePort(shaft, self.node)
        self.sent = []

        class Listening:
            def now(_):
                return port.now()

            def exchange(_, frames):
                frames = list(frames)
                self.sent += frames
                return port.exchange(frames)

        self.bus = Listening()
        self.port = CanOpenPort(self.bus, 1)
        self.master = Master(self.port)
        if pdo:
            self.drive.map_pdos(
                rpdos=[["controlword", "modes_of_operation"], ["target_position"]],
                tpdos=[["statusword", "modes_of_operation_display"]],
            )
            self.port.use_pdos()

    def controlwords(self):
        """Distinct controlwords sent, in order."""
        words = []
        for frame in self.sent:
            if frame.id == 0x601 and frame.data[:4] == b"\x2b\x40\x60\0":
                word = struct.unpack_from("<H", frame.data, 4)[0]
            elif frame.id == 0x201:
                word = struct.unpack_from("<H", frame.data)[0]
            else:
                continue
            if words[-1:] != [word]:
                words.append(word)
        self.sent.clear()
        return words


@pytest.fixture(params=[False, True], ids=["sdo", "pdo"])
def bench(request, shaft):
    return Bench(shaft, request.param)


START = {
    State.SWITCH_ON_DISABLED: (),
    State.READY_TO_SWITCH_ON: (0x06,),
    State.SWITCHED_ON: (0x06, 0x07),
    State.OPERATION_ENABLED: (0x06, 0x07, 0x0F),
    State.QUICK_STOP_ACTIVE: (0x06, 0x07, 0x0F, 0x0B),
}


@pytest.mark.parametrize("state", START, ids=lambda s: s.name)
def test_enable_reaches_operation_enabled_from(bench, state):
    bench.drive.write("quick_stop_option_code", 6)
    for word in START[state]:
        bench.master.control(word)
        bench.shaft.step(4)
    assert bench.drive.state == state
    bench.master.enable()
    assert bench.drive.state == bench.master.state == State.OPERATION_ENABLED


def test_enable_waits_for_a_drive_that_is_not_ready(shaft):
    bench = Bench(shaft)
    bench.drive.reset()
    assert bench.drive.state == State.NOT_READY_TO_SWITCH_ON
    bench.master.enable()
    assert bench.drive.state == State.OPERATION_ENABLED


def test_disable_stops_the_axis_before_the_power_goes(bench):
    bench.master.enable()
    bench.master.set_mode(Mode.PROFILE_VELOCITY)
    bench.master.write("target_velocity", 5 * TURN)
    bench.master.wait_until(lambda w: bool(w & 0x0400), 5.0, "speed")
    bench.sent.clear()
    bench.master.disable()
    assert bench.controlwords() == [0x07, 0x00]
    assert bench.drive.state == State.SWITCH_ON_DISABLED
    assert abs(bench.shaft.speed) < STANDSTILL


@pytest.mark.parametrize(("option", "state"), [(2, "SWITCH_ON_DISABLED"), (6, "QUICK_STOP_ACTIVE")])
def test_quick_stop_ends_at_rest_where_its_option_code_says(bench, option, state):
    bench.drive.write("quick_stop_option_code", option)
    bench.master.enable()
    bench.master.set_mode(Mode.PROFILE_VELOCITY)
    bench.master.write("target_velocity", 5 * TURN)
    bench.master.wait_until(lambda w: bool(w & 0x0400), 5.0, "speed")
    bench.master.quick_stop()
    assert bench.drive.state == State[state]
    assert abs(bench.shaft.speed) < STANDSTILL


@pytest.mark.parametrize("mode", [m for m in Mode if m], ids=lambda m: m.name)
def test_set_mode_returns_when_the_drive_shows_it(bench, mode):
    bench.master.set_mode(mode)
    assert bench.master.mode == bench.drive.mode == mode


def test_a_fault_is_reset_and_needs_its_cause_gone(bench):
    bench.master.enable()
    bench.drive.inject("external")
    with pytest.raises(DriveFault, match=r"FAULT, error code 9000h .*; remove .* reset_fault\(\)"):
        bench.master.wait_until(lambda w: False, 1.0, "work")
    with pytest.raises(DriveFault, match="FAULT, error code 9000h"):
        bench.master.enable()
    with pytest.raises(Timeout, match=r"fault reset: .* FAULT.*error code 9000h .*is still"):
        bench.master.reset_fault(timeout=0.1)
    bench.drive.clear_injected()
    bench.master.reset_fault()
    bench.master.enable()
    bench.sent.clear()
    bench.master.reset_fault()  # without a fault
    assert bench.controlwords() == []
    assert bench.drive.state == State.OPERATION_ENABLED


def position(bench):
    return bench.master.read("position_actual_value")


def test_a_set_point_is_handed_over_with_the_handshake_and_reached(bench):
    bench.master.enable()
    bench.master.set_mode(Mode.PROFILE_POSITION)
    bench.controlwords()
    bench.master.move_to(TURN)
    assert bench.controlwords() == [0x0F, 0x1F, 0x0F]
    assert position(bench) == pytest.approx(TURN, abs=WINDOW)
    bench.master.move_to(TURN // 2, relative=True)
    assert bench.controlwords() == [0x4F, 0x5F, 0x4F]
    assert position(bench) == pytest.approx(1.5 * TURN, abs=WINDOW)


def test_a_buffered_set_point_follows_and_an_immediate_one_replaces(bench):
    bench.master.enable()
    bench.master.set_mode(Mode.PROFILE_POSITION)
    bench.master.move_to(TURN, wait=False)
    bench.master.move_to(3 * TURN, change_on_set_point=True, wait=False)
    assert bench.controlwords()[-3:] == [0x20F, 0x21F, 0x20F]
    assert int(bench.drive.axis.set_points) == 2
    bench.master.move_to(2 * TURN, timeout=60)  # no room: waits until the first is reached
    assert position(bench) == pytest.approx(2 * TURN, abs=WINDOW)
    bench.master.move_to(90 * TURN, wait=False)
    bench.master.move_to(99 * TURN, wait=False)
    bench.master.move_to(0, immediate=True)  # no room: does not wait
    assert position(bench) == pytest.approx(0, abs=WINDOW)
    bench.master.move_to(90 * TURN, wait=False)
    bench.master.move_to(0, immediate=True)
    assert bench.controlwords()[-3:] == [0x2F, 0x3F, 0x2F]
    assert position(bench) == pytest.approx(0, abs=WINDOW)


def test_halt_stops_a_move_and_resume_ends_it(bench):
    bench.master.enable()
    bench.master.set_mode(Mode.PROFILE_POSITION)
    bench.master.move_to(20 * TURN, wait=False)
    bench.shaft.step(400)
    bench.controlwords()
    bench.master.halt()
    assert abs(bench.shaft.speed) < STANDSTILL
    assert abs(position(bench)) < 19 * TURN
    bench.master.resume()
    assert bench.controlwords() == [0x10F, 0x0F]
    bench.master.wait_until(lambda w: w & 0x1400 == 0x400, 60.0, "target")
    assert position(bench) == pytest.approx(20 * TURN, abs=WINDOW)


def test_homing_returns_when_attained_also_a_second_time(bench):
    bench.master.enable()
    for speed in ("speed_during_search_for_switch", "speed_during_search_for_zero"):
        bench.master.write(speed, TURN)
    for method in (37, 34, 34):
        bench.shaft.step(100)
        bench.drive.axis.homed = 0
        bench.master.home(method)
        assert bench.drive.axis.homed
        assert bench.controlwords()[-3:] == [0x0F, 0x1F, 0x0F]


def test_homing_that_fails_or_lasts_too_long_tells_so(bench):
    bench.master.enable()
    bench.master.write("speed_during_search_for_zero", 5 * TURN)
    bench.drive.inject("index_missing")
    with pytest.raises(Timeout, match=r"homing: .*001Fh ENABLE_OPERATION homing_operation_st"):
        bench.master.home(34, timeout=0.05)
    assert bench.controlwords()[-1] == 0x0F
    with pytest.raises(HomingFailed, match=r"homing failed: .*homing_error"):
        bench.master.home(34)


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        (
            "sto_input",
            r"SWITCH_ON_DISABLED remote; .* 0006h SHUTDOWN; voltage_enabled \(bit 4\) is 0",
        ),
        ("enable_input", r"voltage_enabled remote; .* 0006h SHUTDOWN; .* a missing enable input"),
    ],
)
def test_a_time_out_tells_statusword_controlword_and_next_step(shaft, missing, message):
    bench = Bench(shaft)
    setattr(bench.drive.axis, missing, 0)
    with pytest.raises(Timeout, match=r"^enable: not within 0.1 s; node: statusword .*" + message):
        bench.master.enable(timeout=0.1)


@pytest.mark.parametrize("command", ["move_to", "home", "halt", "resume"])
def test_a_motion_does_not_switch_the_power_on(bench, command):
    bench.master.control(0x06)
    bench.master.control(0x07)
    bench.shaft.step(4)
    with pytest.raises(NoPower, match=rf"{command}: .* SWITCHED_ON .* needs enable\(\) first"):
        getattr(bench.master, command)(*[1000] * (command == "move_to"))
    assert bench.controlwords()[-1] == 0x07
    assert bench.drive.state == State.SWITCHED_ON


def test_power_lost_on_the_way_ends_a_move(bench):
    bench.master.enable()
    bench.shaft.after = lambda: setattr(
        bench.drive.axis, "sto_input", 0 if bench.shaft.angle > 1.0 else 1
    )
    with pytest.raises(NoPower, match=r"target 5000000: .* it needs enable\(\) first"):
        bench.master.move_to(5_000_000)


def test_a_fault_on_the_way_ends_a_move(bench):
    bench.master.enable()
    bench.master.move_to(5_000_000, wait=False)
    bench.drive.inject("external")
    with pytest.raises(DriveFault, match="FAULT, error code 9000h"):
        bench.master.move_to(0)


def test_synchronous_pdos_get_a_sync_from_the_master(shaft):
    bench = Bench(shaft)
    bench.drive.map_pdos(rpdos=[["controlword"]], tpdos=[["statusword"]])
    bench.drive.rpdos["transmission_type"] = 1
    bench.drive.tpdos["transmission_type"] = 1
    bench.port.use_pdos()
    bench.master.enable()
    assert Frame(0x080) in bench.sent
    assert bench.drive.state == State.OPERATION_ENABLED


def test_nmt_commands_reach_the_node(bench):
    bench.port.nmt(NmtCommand.STOP)
    assert bench.node.state == NmtState.STOPPED
    with pytest.raises(
        Timeout, match=r"6041h:00h: no answer within 0.1 s, 3 times; .* NMT has not"
    ):
        Master(CanOpenPort(bench.bus, 1, sdo_timeout=0.1)).statusword  # noqa: B018


def test_names_and_values_are_checked_before_they_are_sent(bench):
    bench.sent.clear()
    with pytest.raises(Refused, match=r"no number 'torque_window': see objects.csv"):
        bench.master.write("torque_window", 0)
    with pytest.raises(Refused, match=r"'controlwort': did you mean controlword"):
        bench.master.write("controlwort", 0)
    with pytest.raises(Refused, match="target_position = 2147483648 is not of type INTEGER32"):
        bench.master.write("target_position", 2**31)
    with pytest.raises(ValueError, match=r"node_id = 128 is out of range 1\.\.127"):
        CanOpenPort(bench.bus, 128)
    assert bench.sent == []


# ------------------------------------------------------------------------ SDO


class Script:
    """A server by rote: ``>`` is expected from the client, ``<`` answered."""

    def __init__(self, text):
        self.lines = [line.split() for line in text.strip().splitlines()]
        self.time = 0.0

    def now(self):
        return self.time

    def exchange(self, frames):
        self.time += 0.001
        for frame in frames:
            assert self.lines.pop(0) == [">", str(frame)]
        answers = []
        while self.lines and self.lines[0][0] == "<":
            answers.append(parse(self.lines.pop(0)[1]))
        return answers


EXPEDITED = {
    "1 byte": ("4F01100012000000", b"\x12"),
    "2 bytes": ("4B01100034120000", b"\x34\x12"),
    "3 bytes": ("4701100056341200", b"\x56\x34\x12"),
    "4 bytes": ("4301100078563412", b"\x78\x56\x34\x12"),
    "no size told": ("4201100078563412", b"\x78\x56\x34\x12"),
}


@pytest.mark.parametrize(("answer", "data"), EXPEDITED.values(), ids=EXPEDITED.keys())
def test_an_expedited_upload_gives(answer, data):
    script = Script(f"> 601#4001100000000000\n< 581#{answer}")
    assert SdoClient(script, 1).upload(0x1001) == data


def test_late_answers_and_other_frames_are_no_answers():
    script = Script("""> 601#4001100000000000
        < 581#4F00100099000000
        < 701#05
        < 582#4F01100099000000
        < 581#4F01100012000000""")
    assert SdoClient(script, 1).upload(0x1001) == b"\x12"


def test_a_toggle_bit_not_alternated_is_aborted():
    script = Script("""> 601#4008100000000000
        < 581#4108100008000000
        > 601#6000000000000000
        < 581#1031323334353637
        > 601#8008100000000305""")
    with pytest.raises(SdoAbort) as caught:
        SdoClient(script, 1, attempts=1).upload(0x1008)
    assert caught.value.code == Abort.TOGGLE_BIT
    assert not script.lines


def test_an_abort_code_of_the_manufacturer_survives():
    script = Script("> 601#4001100000000000\n< 581#80011000010000FF")
    with pytest.raises(SdoAbort, match=r"1001h:00h: unknown abort code \(FF000001h\)") as caught:
        SdoClient(script, 1).upload(0x1001)
    assert caught.value.code == 0xFF000001


def test_no_answer_is_a_time_out_told_to_the_server():
    script = Script("> 601#4001100000000000\n> 601#8001100000000405")
    with pytest.raises(Timeout, match=r"node 1, .* 1001h:00h: no answer within 0.5 s; check its"):
        SdoClient(script, 1, timeout=0.5, attempts=1).upload(0x1001)
    assert script.lines == []
    assert script.now() == pytest.approx(0.5, abs=0.01)


def test_a_segmented_upload_of_the_node_is_complete(bench):
    name = b"servogym generic CiA 402 drive"
    assert bench.port.nodes["node"].sdo.upload(0x1008) == name


@pytest.mark.parametrize("size", [0, 1, 4, 5, 7, 8, 14, 20])
def test_a_download_sends_every_byte(size):
    data = bytes(range(1, size + 1))
    received = bytearray()

    class Server:
        """Takes any transfer as CiA 301 tells."""

        time = 0.0

        def now(self):
            return self.time

        def exchange(self, frames):
            self.time += 0.001
            (frame,) = list(frames) or [None]
            command = frame.data[0]
            if command & 0xE0 == 0x20:
                assert frame.data[1:4] == b"\x08\x20\x01"
                if command & 2:
                    received.extend(frame.data[4 : 8 - (command >> 2 & 3)])
                else:
                    assert struct.unpack_from("<I", frame.data, 4)[0] == size
                return [Frame(0x581, b"\x60" + frame.data[1:4] + bytes(4))]
            received.extend(frame.data[1 : 8 - (command >> 1 & 7)])
            assert bool(command & 1) == (len(received) == size)
            return [Frame(0x581, bytes([0x20 | command & 0x10]) + bytes(7))]

    SdoClient(Server(), 1).download(0x2008, 1, data)
    assert received == data


# ----------------------------------------------------------------- a bad bus


def test_a_lost_answer_costs_an_attempt_and_not_the_program():
    script = Script("""> 601#4001100000000000
        > 601#8001100000000405
        > 601#4001100000000000
        < 581#4F01100012000000""")
    assert SdoClient(script, 1, timeout=0.1).upload(0x1001) == b"\x12"
    assert script.lines == []


def test_a_segment_that_is_lost_begins_the_transfer_anew():
    begin = "> 601#4008100000000000\n< 581#4108100008000000\n> 601#6000000000000000\n"
    script = Script(
        begin + "> 601#8008100000000405\n" + begin
        + """< 581#0031323334353637
        > 601#7000000000000000
        < 581#1D38000000000000"""
    )
    assert SdoClient(script, 1, timeout=0.1).upload(0x1008) == b"12345678"
    assert script.lines == []


def test_a_server_that_says_it_waited_in_vain_is_asked_again():
    script = Script("""> 601#2108200106000000
        < 581#6008200100000000
        > 601#0331323334353600
        < 581#8008200100000405
        > 601#2108200106000000
        < 581#6008200100000000
        > 601#0331323334353600
        < 581#2000000000000000""")
    SdoClient(script, 1).download(0x2008, 1, b"123456")
    assert script.lines == []


def test_a_refusal_is_not_asked_again():
    script = Script("> 601#4001100000000000\n< 581#8001100000000206")
    with pytest.raises(SdoAbort, match="object does not exist"):
        SdoClient(script, 1).upload(0x1001)


@pytest.mark.parametrize("seed", range(5, 15))
@pytest.mark.parametrize("pdo", [False, True], ids=["sdo", "pdo"])
@pytest.mark.parametrize("lost", [0.02, 0.04])
def test_a_bus_that_loses_frames_does_not_end_a_masters_work(shaft, lost, pdo, seed):
    bench = Bench(shaft, pdo)
    chance, exchange = random.Random(seed), bench.bus.exchange
    gone = 0

    def lossy(frames):
        nonlocal gone
        kept = [frame for frame in frames if chance.random() >= lost]
        gone += len(list(frames)) - len(kept)
        answers = exchange(kept)
        left = [frame for frame in answers if chance.random() >= lost]
        gone += len(answers) - len(left)
        return left

    bench.bus.exchange = lossy
    port = CanOpenPort(bench.bus, 1)  # with its own time limits: a lost frame costs a second
    if pdo:
        port.use_pdos()
    master = Master(port)
    master.enable()
    master.home(37)
    master.move_to(TURN)
    assert gone
    assert bench.drive.read("position_actual_value") == pytest.approx(TURN, abs=WINDOW)


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_a_target_whose_frame_was_lost_is_not_reported_as_reached(shaft, lost):
    """The drive would answer to the set-point before: acknowledged, and reached at once."""
    bench = Bench(shaft, True)
    port, exchange, left = CanOpenPort(bench.bus, 1), bench.bus.exchange, [lost]

    def without(frames):
        kept = []
        for frame in frames:
            gone = frame.id == 0x301 and left[0] > 0
            left[0] -= gone
            kept += [frame] * (not gone)
        return exchange(kept)

    port.use_pdos()
    master = Master(port)
    master.enable()
    master.home(37)
    bench.bus.exchange = without
    master.move_to(TURN)
    assert left == [0]
    assert bench.drive.read("position_actual_value") == pytest.approx(TURN, abs=WINDOW)


def test_two_nodes_with_one_node_id_are_told():
    nodes = [Node(Drive("generic")), Node(Drive("generic"))]
    port = CanOpenPort(NodePort(linear_axis(), *nodes), 1)
    master = Master(port)
    with pytest.raises(
        BusError, match=r"node 1: two nodes answer .* answers to .* another node-id"
    ):
        master.enable()
    assert isinstance(BusError("a", "b"), ServoError)


def test_another_master_on_the_bus_is_no_second_node(bench):
    """Its requests are heard, and so are the answers to it."""
    port = CanOpenPort(bench.bus, 1)
    exchange = bench.bus.exchange

    def shared(frames):
        other = parse("601#4000100000000000")
        return [other, *exchange([*frames, other])]

    bench.bus.exchange = shared
    master = Master(port)
    for _ in range(5):
        assert master.read("statusword") >= 0
