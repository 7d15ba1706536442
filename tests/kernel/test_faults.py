"""Faults are a set: each comes once, all are reset together, and each is told on the bus.

Metronix ARS 2000 5.5.1 and Festo CMMP-AS table 3.8: 1 an error occurs, 2 acknowledgement while a
cause is left, 3 a further error, 4 acknowledgement with all causes gone. `generic` likewise.
"""

import itertools
import struct

import pytest

from conftest import Shaft
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive
from servogym.drive.kernel.faults import Cause, Reaction
from servogym.drive.kernel.words import State, Statusword
from servogym.drive.model.model import load, model_names

CAN = [model for model in model_names() if load(model).bus == "can"]
RESET = 0x80


def stopping(model):
    """Causes a fault of the model has that can only come by injection and stop the drive."""
    own = (Cause.OVERVOLTAGE, Cause.EXTERNAL, Cause.SHORT_CIRCUIT, Cause.DRIVE_TEMPERATURE)
    rows = {f.cause: f for f in reversed(load(model).faults)}
    found = [rows[c] for c in own if c in rows and rows[c].reaction > Reaction.WARNING]
    return found[:2]


class Bus:
    """A node of a model; its emergency messages as (error code, register)."""

    def __init__(self, model):
        self.drive = Drive(model, node_id=1)
        self.node = Node(self.drive)
        self.time = 0
        self.period = round(self.drive.model.cycle_time["position"] * 1e6)
        self.told()

    def told(self, cycles=3):
        found = []
        for _ in range(cycles):
            self.drive.cycle(0.0)
            self.time += self.period
            for frame in self.node.poll(self.time):
                if frame.id == 0x081:
                    found.append(struct.unpack_from("<HB", frame.data))
        return found

    def reset_fault(self):
        self.drive.axis.fault_cycle = -(
            10**9
        )  # the time in which some models take no reset is over
        if self.drive.axis.od.command_source:
            self.drive.axis.od.command_source = 1  # where contacts would reset
        for word in (0, RESET, 0):
            self.drive.write("controlword", word)
            self.told()


@pytest.mark.parametrize("model", CAN)
def test_a_further_fault_is_told_and_entered(model):
    first, second = stopping(model)
    bus = Bus(model)
    bus.drive.inject(first.cause)
    assert [code for code, _ in bus.told()] == [first.code]
    assert bus.drive.state == State.FAULT
    bus.drive.inject(second.cause)
    told = bus.told()
    both = 1 | 1 << first.register | 1 << second.register
    assert told == [(second.code, both)]
    assert bus.drive.axis.od.error_field[:2].tolist() == [second.code, first.code]
    assert bus.drive.read("error_code") == second.code
    assert bus.drive.fault.startswith(f"{first.code:04X}h"), "what stopped the drive"
    assert [text[:4] for text in bus.drive.faults] == [f"{f.code:04X}" for f in (first, second)]
    assert bus.told(20) == [], "told once"


@pytest.mark.parametrize("model", CAN)
def test_a_reset_takes_all_faults_or_none(model):
    first, second = stopping(model)
    for left in (first, second):
        bus = Bus(model)
        for fault in (first, second):
            bus.drive.inject(fault.cause)
            bus.told()
        bus.drive.axis.injected = 1 << left.cause
        bus.told()
        count = int(bus.drive.axis.error_events)
        bus.reset_fault()
        assert bus.drive.state == State.FAULT
        assert int(bus.drive.axis.faults) == 1 << first.cause | 1 << second.cause
        assert bus.drive.axis.error_events == count
        bus.drive.clear_injected()
        bus.told()
        bus.drive.axis.fault_cycle = -(10**9)
        bus.drive.write("controlword", RESET)
        assert bus.told()[-1:] == [(0, 0)]
        assert bus.drive.axis.faults == bus.drive.axis.fault == 0
        assert bus.drive.state == State.SWITCH_ON_DISABLED
        bus.drive.inject(second.cause)
        assert [code for code, _ in bus.told()] == [second.code], "a new one after the reset"


@pytest.mark.parametrize("model", CAN)
def test_a_history_cleared_before_the_next_poll_leaves_the_emcy_as_it_was(model):
    (fault, _) = stopping(model)
    bus = Bus(model)
    bus.drive.inject(fault.cause)
    for _ in range(3):
        bus.drive.cycle(0.0)
    bus.drive.axis.od.error_field[:] = 0
    bus.drive.axis.od.error_count = 0
    if (0x1003, 0) in bus.drive.objects.slots:
        bus.drive.write(0x1003, 0, 0)
    assert [code for code, _ in bus.told()] == [fault.code]


@pytest.mark.parametrize("order", [*itertools.permutations(range(3))])
def test_each_of_several_faults_in_one_cycle_is_entered(order):
    shaft = Shaft().enable()
    causes = (Cause.OVERVOLTAGE, Cause.EXTERNAL, Cause.DRIVE_TEMPERATURE)
    for n in order:
        shaft.drive.inject(causes[n])
    shaft.step(3)
    codes = {int(shaft.axis.fault_code[cause]) for cause in causes}
    assert shaft.read("number_of_errors") == 3
    assert set(shaft.axis.od.error_field[:3].tolist()) == codes


def test_a_further_fault_that_takes_the_power_away_ends_the_braking():
    shaft = Shaft().enable()
    shaft.write(fault_reaction_option_code=2, quick_stop_deceleration=1_000_000)
    shaft.speed = 50.0
    shaft.axis.od.fault_reaction[Cause.EXTERNAL] = Reaction.QUICK_STOP
    shaft.axis.od.fault_reaction[Cause.OVERVOLTAGE] = Reaction.QUICK_STOP
    shaft.axis.od.fault_reaction[Cause.SHORT_CIRCUIT] = Reaction.DISABLE
    shaft.drive.inject("external")
    shaft.step(3)
    assert shaft.drive.state == State.FAULT_REACTION_ACTIVE
    shaft.drive.inject("overvoltage")
    shaft.step(3)
    assert shaft.drive.state == State.FAULT_REACTION_ACTIVE, "it brakes already"
    shaft.drive.inject("short_circuit")
    shaft.step(3)
    assert shaft.drive.state == State.FAULT
    assert shaft.torque == 0.0
    assert shaft.read("number_of_errors") == 3


def test_the_register_shows_every_fault_and_every_warning():
    shaft = Shaft()
    shaft.axis.od.fault_reaction[Cause.MOTOR_TEMPERATURE] = Reaction.WARNING
    causes = (Cause.OVERVOLTAGE, Cause.EXTERNAL, Cause.MOTOR_TEMPERATURE)
    register = 0
    for cause in causes:
        shaft.drive.inject(cause)
        shaft.step(3)
        register |= int(shaft.axis.fault_register[cause])
        assert shaft.read("error_register") == register
    assert shaft.bit(Statusword.WARNING)
    shaft.axis.injected = 0
    shaft.step(3)
    assert shaft.read("error_register") == register & ~8, "the warning has gone, faults stay"


def test_faults_of_one_number_after_another_are_two():
    drive = Drive("festo_cmmp_as")
    for number in ("05-0", "06-0"):
        drive.inject(number)
        for _ in range(3):
            drive.cycle(0.0)
    codes = [f.code for n in ("06-0", "05-0") for f in drive.model.faults if f.name == n]
    assert drive.axis.od.error_field[:2].tolist() == codes[:2]
