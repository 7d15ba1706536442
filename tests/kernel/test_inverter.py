"""Bonfiglioli ACT: contacts, state machine, run-down, parameters and data sets, CANopen details."""

import struct
from itertools import pairwise

import pytest

from conftest import Shaft
from servogym.drive.canopen.frame import parse
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive
from servogym.drive.kernel.contacts import Source
from servogym.drive.kernel.words import State
from servogym.drive.objects.abort import Abort, SdoAbort

S1, S2, S3, S8 = 1, 2, 4, 0x80
MACHINE, CONTACTS, REMOTE = 1, 0, 2
RPM = 2 * 3.141592653589793 / 60


@pytest.fixture
def shaft():
    shaft = Shaft("bonfiglioli_act")
    shaft.inertia = 5e-3
    shaft.axis.terminals = S1 | S2
    return shaft


def control_by(shaft, source):
    for data_set in (1, 2, 3, 4):
        shaft.drive.write(0x219C, data_set, source)
    shaft.step(4)
    return shaft


def run(shaft, speed=600):
    control_by(shaft, MACHINE)
    shaft.drive.write("vl_target_velocity", speed)
    for word in (6, 7, 15):
        shaft.control(word, 3)
    assert shaft.drive.state == State.OPERATION_ENABLED
    shaft.until(lambda: shaft.bit(0x400))
    shaft.step(200)
    return shaft


def shown(shaft):
    return shaft.read("statusword") & 0x6F


# ------------------------------------------------------------------ control


def test_with_the_factory_setting_nothing_starts(shaft):
    assert shaft.drive.read(0x219C, 0) == 44
    for word in (6, 7, 15):
        shaft.control(word, 5)
    assert shown(shaft) == 0x23
    assert not shaft.bit(0x200)
    assert abs(shaft.torque) == 0


def test_the_state_machine_needs_the_hardware_enable(shaft):
    control_by(shaft, MACHINE)
    shaft.axis.terminals = S1
    for word in (6, 7, 15):
        shaft.control(word, 4)
    assert shown(shaft) == 0x23
    assert not shaft.bit(0x200)
    shaft.axis.terminals = S1 | S3
    shaft.step(3)
    assert shown(shaft) == 0x27
    assert shaft.bit(0x200)


def test_enable_operation_leads_from_switch_on_disabled_to_operation(shaft):
    control_by(shaft, MACHINE)
    shaft.control(0, 3)
    assert shown(shaft) & 0x4F == 0x40
    shaft.control(15, 6)
    assert shown(shaft) == 0x27


def test_losing_s1ind_coasts_at_once(shaft):
    run(shaft)
    speed = shaft.speed
    shaft.axis.terminals = S2
    shaft.step(2)
    assert shown(shaft) == 0x23
    shaft.step(200)
    assert shaft.speed == pytest.approx(speed, rel=0.02)


@pytest.mark.parametrize(("contacts", "sign"), [(S1 | S2, 1), (S1 | S3, -1)])
def test_contacts_start_either_way_and_know_three_states(shaft, contacts, sign):
    shaft.axis.terminals = 0
    control_by(shaft, CONTACTS)
    shaft.drive.write("vl_target_velocity", 300)
    assert shown(shaft) == 0x23
    shaft.control(0x0F, 5)
    assert shown(shaft) == 0x23, "the controlword is not relevant"
    shaft.axis.terminals = contacts
    shaft.until(lambda: shown(shaft) == 0x27, 20)
    shaft.until(lambda: shaft.bit(0x400))
    assert shaft.speed / RPM == pytest.approx(sign * 300, abs=30)
    assert not shaft.bit(0x200)


def test_the_same_speed_the_other_way_round_is_not_the_target(shaft):
    run(shaft, 600)
    shaft.drive.write("vl_target_velocity", -300)
    shaft.step(5)
    shaft.until(lambda: shaft.bit(0x400))
    assert shaft.speed / RPM == pytest.approx(-300, abs=30)


def test_remote_contacts_are_the_controlword_and_the_hardware_s1ind(shaft):
    control_by(shaft, REMOTE)
    shaft.drive.write("vl_target_velocity", 300)
    shaft.axis.terminals = 0
    shaft.control(S1 | S2, 10)
    assert shown(shaft) == 0x23
    assert not shaft.bit(0x200)
    shaft.axis.terminals = S1
    shaft.step(10)
    assert shown(shaft) == 0x27
    assert shaft.bit(0x200)
    assert shaft.drive.read(0x20FA) == S1 | S2
    shaft.axis.terminals = 0
    shaft.step(2)
    assert shaft.drive.read(0x20FA) == S2


@pytest.mark.parametrize("bits", [0x10, 0x20, 0x40, 0x70])
def test_the_ramp_bits_of_the_controlword_mean_nothing(shaft, bits):
    run(shaft)
    shaft.control(0x0F | bits, 100)
    assert shaft.bit(0x400)


# ------------------------------------------------------------------ run-down


def test_transition_5_runs_down_and_can_be_called_back(shaft):
    run(shaft)
    shaft.control(0x07, 200)
    assert shown(shaft) == 0x27, "still running down"
    assert abs(shaft.speed / RPM) < 590
    shaft.control(0x0F)
    shaft.until(lambda: shaft.bit(0x400))
    shaft.control(0x07)
    waited = shaft.until(lambda: shown(shaft) == 0x23)
    assert waited > 1000, "the holding time 638 of 1 s"
    assert abs(shaft.speed / RPM) < 30


def test_transition_5_coasts_or_brakes_with_dc(shaft):
    run(shaft)
    shaft.drive.write(0x2188, 0, 0)
    speed = shaft.speed
    shaft.control(0x07, 3)
    assert shown(shaft) == 0x23
    assert shaft.speed == pytest.approx(speed, rel=0.02)
    shaft.drive.write(0x2188, 0, 1)
    shaft.drive.write(0x2278, 0, 20)
    shaft.control(0x0F, 3)
    shaft.until(lambda: shaft.bit(0x400))
    shaft.control(0x07, 300)
    shaft.control(0x0F, 300)
    assert abs(shaft.speed / RPM) < 30, "until the end of the braking no controlword is accepted"
    assert shown(shaft) == 0x27
    shaft.control(0x07)
    shaft.until(lambda: shown(shaft) == 0x23, 2500)


def test_quick_stop_uses_its_own_ramp_and_ends_without_power(shaft):
    run(shaft, 1200)
    shaft.control(0x02)
    assert shown(shaft) == 0x07
    shaft.until(lambda: shaft.drive.state == State.SWITCH_ON_DISABLED)
    assert abs(shaft.speed / RPM) < 30


def test_a_fault_can_be_reset_after_15_s(shaft):
    control_by(shaft, MACHINE)
    shaft.drive.inject("overvoltage")
    shaft.step(3)
    shaft.drive.clear_injected()
    shaft.control(0)
    shaft.control(0x80)
    assert shaft.drive.state == State.FAULT
    assert shaft.drive.read(0x2104) == 0x0700, "F07 00"
    shaft.step(15_000)
    shaft.control(0)
    shaft.control(0x80)
    assert shaft.drive.state == State.SWITCH_ON_DISABLED


def test_the_speed_gives_way_under_load_along_the_slip_line(shaft):
    run(shaft, 1000)
    shaft.load = -2.55  # half the rated torque
    shaft.step(3000)
    assert shaft.speed / RPM == pytest.approx(950, abs=10)
    shaft.load = -30.0
    shaft.step(50)
    assert shaft.bit(0x800), "the breakdown torque is the limit"


@pytest.mark.parametrize(("reaction", "state"), [(0, 0x27), (1, 0x08), (2, 0x23), (3, 0x40)])
def test_bus_failure_reactions(shaft, reaction, state):
    run(shaft)
    shaft.drive.write(0x6007, 0, reaction)
    shaft.axis.connection_lost = 1
    shaft.step(5000)
    assert shaft.read("statusword") & 0x4F == state & 0x4F


@pytest.mark.parametrize("source", [CONTACTS, REMOTE])
@pytest.mark.parametrize("reaction", [2, 3])
def test_contacts_keep_running_without_the_bus(shaft, source, reaction):
    control_by(shaft, source)
    shaft.drive.write("vl_target_velocity", 300)
    shaft.control(S1 | S2, 10)
    shaft.drive.write(0x6007, 0, reaction)
    shaft.axis.connection_lost = 1
    shaft.step(3000)
    assert shown(shaft) == 0x27
    assert shaft.speed / RPM == pytest.approx(300, abs=30)


# --------------------------------------------------------------- parameters


def refused(shaft, *arguments):
    access = shaft.drive.read if len(arguments) == 2 else shaft.drive.write
    with pytest.raises(SdoAbort) as error:
        access(*arguments)
    return error.value.code


def test_data_set_0_is_all_four_while_they_are_the_same(shaft):
    shaft.drive.write(0x21A4, 0, 700)
    assert [shaft.drive.read(0x21A4, n) for n in range(10)] == [700] * 10
    shaft.drive.write(0x21A4, 2, 800)
    assert [shaft.drive.read(0x21A4, n) for n in (1, 2, 6, 7)] == [700, 800, 700, 800]
    assert refused(shaft, 0x21A4, 0) == Abort.INTERNAL_INCOMPATIBLE
    assert refused(shaft, 0x21A4, 0, 900) == Abort.INTERNAL_INCOMPATIBLE
    assert refused(shaft, 0x21A4, 1, 0) == Abort.VALUE_TOO_LOW
    assert refused(shaft, 0x200C, 0) == Abort.INTERNAL_INCOMPATIBLE


def test_the_ram_is_lost_and_the_eeprom_stays(shaft):
    shaft.drive.write(0x21A4, 6, 123)
    shaft.drive.write(0x21A4, 2, 234)
    assert shaft.drive.read(0x21A4, 1) == 500
    shaft.drive.reset(keep_parameters=True)
    assert [shaft.drive.read(0x21A4, n) for n in (6, 7)] == [500, 234]


def test_what_the_eeprom_has_outlives_a_power_cycle_and_a_file_the_emulator(tmp_path):
    file = tmp_path / "act.json"
    drive = Drive("bonfiglioli_act", parameter_file=file)
    drive.write(0x21A4, 0, 700)
    drive.write(0x21A4, 7, 800)
    drive.reset()
    again = Drive("bonfiglioli_act", parameter_file=file)
    for one in (drive, again):
        assert [one.read(0x21A4, n) for n in (1, 2, 7)] == [700, 700, 700]


def test_388_and_6007h_are_the_same(shaft):
    shaft.drive.write(0x2184, 0, 3)
    assert shaft.drive.read(0x6007, 0) == 3


def test_losing_s1ind_ends_a_quick_stop_by_coasting(shaft):
    run(shaft, 1200)
    shaft.control(0x02, 20)
    speed = shaft.speed
    shaft.axis.terminals = S2
    shaft.step(50)
    assert shaft.drive.state == State.SWITCH_ON_DISABLED
    assert shaft.speed == pytest.approx(speed, rel=0.05)


def test_the_active_data_set_decides_and_is_shown(shaft):
    shaft.drive.write(0x219C, 2, MACHINE)
    assert shaft.axis.od.command_source == Source.NOTHING
    shaft.drive.write(0x219E, 0, 2)
    assert shaft.axis.od.command_source == Source.CONTROLWORD_AND_CONTACTS
    assert shaft.drive.read(0x20F9) == 2


def test_ramps_poles_and_amounts_go_to_parameters_of_data_set_1(shaft):
    shaft.drive.write(0x6048, 1, 3000)
    assert shaft.drive.read(0x21A4, 1) == shaft.drive.read(0x21A6, 1) == 10_000, "100 Hz/s"
    shaft.drive.write(0x6048, 2, 2)
    assert shaft.drive.read(0x21A4, 1) == 5_000
    shaft.drive.write(0x6046, 2, 900)
    assert shaft.drive.read(0x21A3, 1) == 3_000, "30 Hz"
    shaft.drive.write(0x604D, 0, 6)
    assert shaft.drive.read(0x2175, 1) == 3
    assert shaft.drive.read(0x6046, 2) == 600
    assert refused(shaft, 0x604D, 0, 5) == Abort.INVALID_VALUE


def test_a_target_is_bounded_by_the_amounts(shaft):
    shaft.drive.write(0x6046, 2, 500)
    run(shaft, 1000)
    assert shaft.read("vl_velocity_demand") == 500
    assert shaft.drive.read(0x211A) == 3333, "33.33 Hz from the bus"
    assert shaft.drive.read(0x211B) == 3333


@pytest.mark.parametrize(("source", "speed"), [(1, 300), (2, 600), (3, 900)])
def test_the_ramp_setpoint_is_internal_bus_or_sum(shaft, source, speed):
    shaft.drive.write(0x21E0, 0, 1000)  # 10 Hz
    shaft.drive.write(0x21B2, 0, source)
    run(shaft, 600)
    assert shaft.read("vl_velocity_demand") == speed


def test_another_mode_is_ignored(shaft):
    shaft.drive.write("modes_of_operation", 1)
    assert shaft.drive.read("modes_of_operation") == 2
    assert shaft.read("modes_of_operation_display") == 2


SEL, ENQ, ACK, NAK = 2, 5, 6, 15


def ask(shaft, subindex, number, command, data=b"", data_set=0):
    od = shaft.drive.objects
    word = number + 1000 * data_set
    size = {1: 6, 2: 8, 3: 36}[subindex]
    request = (struct.pack("<HBB", word, command, 0) + data).ljust(size, b"\0")
    assert od.write(0x2000, subindex, request) is Abort.NONE
    result, abort = od.read(0x2000, subindex)
    assert abort is Abort.NONE
    assert len(result) == size
    assert struct.unpack_from("<H", result)[0] == word
    return result[2], result[4:]


def test_the_parameter_channel_reads_and_writes(shaft):
    assert ask(shaft, 1, 412, ENQ, data_set=1) == (ACK, struct.pack("<h", 44))
    assert ask(shaft, 1, 412, SEL, struct.pack("<h", 1), data_set=1)[0] == ACK
    assert shaft.drive.read(0x219C, 1) == 1
    assert ask(shaft, 2, 420, ENQ) == (ACK, struct.pack("<i", 500))
    assert ask(shaft, 3, 14, ENQ)[1].startswith(b"ACT 10-1\0")


def test_the_channel_writes_data_set_0_even_if_the_four_differ(shaft):
    shaft.drive.write(0x21A4, 2, 800)
    assert ask(shaft, 2, 420, ENQ) == (NAK, b"\x09\0\0\0")
    assert ask(shaft, 2, 420, SEL, struct.pack("<i", 900))[0] == ACK
    assert shaft.drive.read(0x21A4, 0) == 900


@pytest.mark.parametrize(
    ("subindex", "number", "command", "data", "data_set", "error"),
    [
        (1, 412, 9, b"", 1, 0),
        (1, 412, SEL, b"\x63\0", 1, 1),
        (1, 392, ENQ, b"", 3, 2),
        (1, 249, SEL, b"\1\0", 0, 4),
        (3, 14, SEL, b"X", 0, 4),
        (2, 412, ENQ, b"", 1, 10),
        (1, 999, ENQ, b"", 0, 11),
    ],
)
def test_errors_of_the_channel(shaft, subindex, number, command, data, data_set, error):
    kind, rest = ask(shaft, subindex, number, command, data, data_set)
    assert kind == NAK
    assert rest[0] == error


# ---------------------------------------------------------------------- bus


class Bus:
    def __init__(self, shaft):
        self.shaft, self.node, self.time = shaft, Node(shaft.drive), 0
        self.run(1)

    def run(self, milliseconds, *frames):
        for text in frames:
            self.node.receive(parse(text), self.time)
        got = []
        for _ in range(milliseconds):
            self.time += 1000
            self.shaft.step()
            got += [(self.time, str(frame)) for frame in self.node.poll(self.time)]
        return got


def test_tpdo_2_comes_on_change_and_every_second_but_not_too_often(shaft):
    control_by(shaft, MACHINE)
    bus = Bus(shaft)
    first = bus.run(100, "000#0101")
    assert {frame[:4] for _, frame in first} == {"181#", "281#"}
    quiet = bus.run(3000)
    assert [frame[:4] for _, frame in quiet] == ["281#"] * 3
    shaft.drive.write(0x1801, 1, 0x8000_0281)
    shaft.drive.write(0x1801, 3, 0)
    shaft.drive.write(0x1801, 1, 0x281)
    bus.run(1, "301#0600B004")
    bus.run(3, "301#0700B004")
    moving = [time for time, frame in bus.run(500, "301#0F00B004") if frame.startswith("281#")]
    gaps = [after - before for before, after in pairwise(moving)]
    assert min(gaps) == 20_000


def test_emcy_carries_the_internal_fault_code(shaft):
    bus = Bus(shaft)
    bus.run(1, "000#0101")
    shaft.drive.inject("overvoltage")
    frames = [frame for _, frame in bus.run(5)]
    assert "081#1032050000000007" in frames


def test_the_parameter_channel_over_segmented_sdo(shaft):
    bus = Bus(shaft)
    frames = bus.run(1, "601#2100200106000000")
    assert frames[-1][1] == "581#6000200100000000"
    frames = bus.run(1, "601#039C0105000000" + "00")
    assert frames[-1][1] == "581#2000000000000000"
    frames = bus.run(1, "601#4000200100000000")
    assert frames[-1][1] == "581#4100200106000000"
    frames = bus.run(1, "601#6000000000000000")
    assert frames[-1][1] == "581#039C0106002C0000"
