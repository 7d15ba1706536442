"""Sentences of the ACT's CANopen manual, each named by its section."""

import struct

import pytest

from conftest import Shaft
from servogym.drive.canopen.frame import parse
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive

MACHINE = 1  # value of 412
F_UP, A_UP, F_DOWN, A_DOWN, QUICK, A_QUICK = (0x21A4, 0x21A6, 0x21A5, 0x21A7, 0x21A8, 0x21A9)
RPM = 0.10471975511965977
SINGLES = (0x2181, 0x2183, 0x2184, 0x2188, 0x2197, 0x219E, 0x2225, 0x2278)


@pytest.fixture
def shaft():
    shaft = Shaft("bonfiglioli_act")
    shaft.inertia = 15e-4
    shaft.drive.write(0x219C, 0, MACHINE)
    return shaft


def run(shaft, speed):
    shaft.drive.write("vl_target_velocity", speed)
    for word in (6, 7, 15):
        shaft.control(word, 4)


@pytest.mark.parametrize("source", [1, 2, 3])
def test_9_4_parameter_283_is_the_sum_of_228_and_282(shaft, source):
    shaft.drive.write(0x21E0, 0, 1000)
    shaft.drive.write(0x21B2, 0, source)
    shaft.drive.write("vl_target_velocity", -600)
    shaft.step()
    assert shaft.drive.read(0x20E4) == 1000
    assert shaft.drive.read(0x211A) == -2000
    assert shaft.drive.read(0x211B) == -1000


def test_8_5_5_the_least_speed_is_not_saved_and_0_after_a_reset(shaft):
    shaft.drive.write(0x6046, 1, 300)
    assert shaft.drive.read(0x6046, 1) == 300
    assert shaft.drive.read(0x21A2, 6) == 1000, "10 Hz in the RAM of 418"
    assert shaft.drive.read(0x21A2, 1) == Drive("bonfiglioli_act").read(0x21A2, 1)
    shaft.drive.write(0x21A2, 2, 700)
    shaft.drive.reset()
    assert shaft.drive.read(0x6046, 1) == 0


@pytest.mark.parametrize("unrelated", [False, True])
def test_8_6_3_one_rule_of_persistence_for_6nnnh_and_2nnnh(shaft, unrelated):
    shaft.drive.write(0x6046, 2, 900)
    shaft.drive.write(0x6048, 1, 3000)
    shaft.drive.write(0x6048, 2, 2)
    shaft.drive.write(0x604D, 0, 6)
    shaft.drive.write(0x6007, 0, 2)
    if unrelated:
        shaft.drive.write(0x2225, 0, 50)
    shaft.drive.reset()
    assert shaft.drive.read(0x21A3, 1) == 3000
    assert shaft.drive.read(0x6046, 2) == 600, "8.5.5: from 419, with three pole pairs now"
    assert shaft.drive.read(0x21A4, 1) == shaft.drive.read(0x21A6, 1) == 5000
    assert (shaft.drive.read(0x6048, 1), shaft.drive.read(0x6048, 2)) == (1000, 1)
    assert shaft.drive.read(0x6007) == shaft.drive.read(0x2184) == 2


@pytest.mark.parametrize("index", SINGLES)
def test_8_6_3_data_set_5_of_a_single_parameter_is_its_ram_copy(shaft, index):
    first = shaft.drive.read(index, 0)
    other = 2 if first == 1 else 1
    assert shaft.drive.read(index, 5) == first
    shaft.drive.write(index, 5, other)
    assert (shaft.drive.read(index, 0), shaft.drive.read(index, 5)) == (first, other)
    shaft.drive.write(0x2172, 1, 333)  # some write that stores
    shaft.drive.reset()
    assert (shaft.drive.read(index, 0), shaft.drive.read(index, 5)) == (first, first)
    shaft.drive.write(index, 0, other)
    assert shaft.drive.read(index, 5) == other
    shaft.drive.reset()
    assert shaft.drive.read(index, 0) == other


@pytest.mark.parametrize(("speed", "up", "down"), [(600, F_UP, F_DOWN), (-600, A_UP, A_DOWN)])
def test_10_2_each_direction_has_its_slopes(shaft, speed, up, down):
    for index in (F_UP, A_UP, F_DOWN, A_DOWN):
        shaft.drive.write(index, 0, 1000 if index in (up, down) else 99_999)
    run(shaft, speed)
    before = shaft.read("vl_velocity_demand")
    shaft.step(500)
    change = (shaft.read("vl_velocity_demand") - before) * (1 if speed > 0 else -1)
    assert change == pytest.approx(150, abs=3), "10 Hz/s are 300 1/min per second"
    shaft.step(2500)
    shaft.drive.write("vl_target_velocity", 0)
    before = shaft.read("vl_velocity_demand")
    shaft.step(500)
    change = (before - shaft.read("vl_velocity_demand")) * (1 if speed > 0 else -1)
    assert change == pytest.approx(150, abs=3)


def test_10_2_a_negative_422_is_as_clockwise(shaft):
    shaft.drive.write(F_UP, 0, 1000)
    shaft.drive.write(A_UP, 0, -1)
    run(shaft, -600)
    before = shaft.read("vl_velocity_demand")
    shaft.step(500)
    assert before - shaft.read("vl_velocity_demand") == pytest.approx(150, abs=3)


@pytest.mark.parametrize(("speed", "index"), [(1200, QUICK), (-1200, A_QUICK)])
def test_9_2_1_quick_stop_ramps_are_424_clockwise_and_425_anticlockwise(shaft, speed, index):
    shaft.drive.write(F_UP, 0, 99_999)
    shaft.drive.write(A_UP, 0, 99_999)
    shaft.drive.write(QUICK, 0, 99_999)
    shaft.drive.write(A_QUICK, 0, 99_999)
    shaft.drive.write(index, 0, 1000)
    run(shaft, speed)
    shaft.step(1500)
    before = shaft.read("vl_velocity_demand")
    shaft.control(2, 500)
    assert abs(before - shaft.read("vl_velocity_demand")) == pytest.approx(150, abs=3)


def test_9_4_with_434_2_the_sign_at_0_is_that_of_the_last_setpoint(shaft):
    shaft.drive.write(0x21B2, 0, 2)
    shaft.drive.write(0x6046, 1, 300)
    for speed, expected in ((0, 300), (-600, -600), (0, -300), (100, 300), (0, 300)):
        run(shaft, speed)
        shaft.step(9000)
        assert shaft.read("vl_velocity_demand") == expected


class Bus:
    def __init__(self, shaft):
        self.shaft, self.node, self.time = shaft, Node(shaft.drive), 0
        self.run(1, "000#0101")

    def run(self, milliseconds, *frames):
        for text in frames:
            self.node.receive(parse(text), self.time)
        got = []
        for _ in range(milliseconds):
            self.time += 1000
            self.shaft.step()
            got += [str(frame) for frame in self.node.poll(self.time)]
        return got


@pytest.mark.parametrize("failed", [5, 42, 127])
def test_7_the_key_of_a_heartbeat_failure_is_f20_nn(shaft, failed):
    shaft.drive.write(0x1016, 1, failed << 16 | 50)
    bus = Bus(shaft)
    bus.run(10, f"{0x700 + failed:03X}#05")
    frames = bus.run(100)
    key = struct.pack("<H", 0x2000 | failed).hex().upper()
    assert [f for f in frames if f.startswith("081#")] == [f"081#001011000000{key}"]
    assert shaft.drive.read(0x2104) == 0x2000 | failed


def test_7_the_key_of_a_guarding_failure_is_f20_22(shaft):
    shaft.drive.write(0x100C, 0, 10)
    shaft.drive.write(0x100D, 0, 3)
    bus = Bus(shaft)
    bus.run(10, "701#R")
    assert "081#0010110000002220" in bus.run(100)
    assert shaft.drive.read(0x2104) == 0x2022


@pytest.mark.parametrize("reaction", [0, 2, 3])
def test_7_only_reaction_1_is_a_fault_message(shaft, reaction):
    shaft.drive.write(0x1016, 1, 5 << 16 | 50)
    shaft.drive.write(0x6007, 0, reaction)
    bus = Bus(shaft)
    bus.run(10, "705#05")
    frames = bus.run(200)
    frames += bus.run(50, "705#05")
    assert not [f for f in frames if f.startswith("081#")]
    assert shaft.drive.read(0x2104) == 0
    assert shaft.read("error_register") == 0
