"""One script on every port with every drive model: the same calls, the same errors."""

import pickle
from functools import partial

import pytest
from masters.ports import CASES, axis

from servogym.drive.kernel.words import Mode, State
from servogym.drive.master import (
    DriveFault,
    HomingFailed,
    Interlock,
    Master,
    NoPower,
    Refused,
    ServoError,
    Timeout,
)
from servogym.drive.master.errors import Status
from servogym.drive.objects.abort import SdoAbort

HERE = 0.12  # m, where the axis stands at power-on
NEAR = 30e-6  # m, the position window and what the encoder resolves
LOCKED = 20.0  # s, longer than an inverter refuses to be reset


class Bench:
    def __init__(self, model, bus, port):
        self.machine = axis(model, bus)
        self.drive = self.machine.drives["x"]
        self.master = Master(port(self.machine))
        self.positions = Mode.PROFILE_POSITION in self.drive.model.modes

    @property
    def place(self):
        return self.machine.data.qpos[0]

    def referenced(self):
        self.master.enable()
        if self.positions:
            self.master.write("home_offset", round(-HERE * 1e6))
            self.master.home(self.drive.model.homes_here)
        return self.master


@pytest.fixture(params=CASES, ids=lambda case: f"{case[0]}-{case[1]}-{case[2].__name__}")
def bench(request):
    bench = Bench(*request.param)
    if not bench.positions:
        for data_set in (1, 2, 3, 4):
            bench.drive.write(0x219C, data_set, 1)  # the state machine commands, not the contacts
    return bench


def positioning(bench):
    if not bench.positions:
        pytest.skip("a drive without positions")


def test_the_working_day(bench):
    master = bench.master
    assert master.axes == ("x",)
    master.enable()
    assert master.state == bench.drive.state == State.OPERATION_ENABLED
    if bench.positions:
        bench.referenced()
        assert master.position == pytest.approx(HERE, abs=NEAR)
        for target in (0.15, 0.1):
            master.move_to(target)
            assert bench.place == pytest.approx(target, abs=NEAR)
            assert master.position == pytest.approx(target, abs=NEAR)
        master.move_to(0.02, relative=True)
        assert bench.place == pytest.approx(0.12, abs=NEAR)
        before = bench.place
        master.jog(0.1, 0.2)
        assert 0.02 < bench.place - before < 0.05
        master.jog(-0.1)
        master.quick_stop()
        master.enable()
        master.jog(0.1)
    master.disable()
    assert bench.drive.state == State.SWITCH_ON_DISABLED
    assert abs(bench.machine.data.qvel[0]) < 5e-3


def test_a_fault_is_told_reset_and_needs_its_cause_gone(bench):
    master = bench.referenced()
    cause = next(c for c in ("external", "overvoltage") if c in bench.drive.injectable)
    bench.drive.inject(cause)
    with pytest.raises(
        DriveFault, match=r"work: FAULT, error code [0-9A-F]{4}h \w.*x: statusword"
    ) as e:
        master.wait_until(lambda word: False, 5.0, "work")
    assert e.value.axes == ("x",)
    assert e.value.state in (State.FAULT, State.FAULT_REACTION_ACTIVE)
    assert e.value.next_step.endswith("; remove the cause, then reset_fault()")
    assert bench.drive.fault[:5] in e.value.received
    named = rf"FAULT, error code {bench.drive.fault[:5]}.*; remove the cause, then reset_fault\(\)"
    for refused in (master.home, master.halt, partial(master.jog, 0.1)):
        with pytest.raises(DriveFault, match=named + r" and enable\(\)"):
            refused()
    assert master.stop() == ()  # it has no power
    assert bench.drive.fault[:5] in e.value.received
    assert isinstance(e.value, RuntimeError)
    with pytest.raises(DriveFault, match="enable: FAULT"):
        master.enable()
    with pytest.raises(Timeout, match=r"fault reset: not within 0.1 s; x: .*error code .*is still"):
        master.reset_fault(timeout=0.1)
    bench.drive.clear_injected()
    master.reset_fault(timeout=LOCKED)
    assert bench.drive.state == State.SWITCH_ON_DISABLED
    master.enable()
    master.reset_fault()  # without a fault nothing happens
    assert bench.drive.state == State.OPERATION_ENABLED


def test_a_motion_needs_power(bench):
    bench.master.wait(0.05)
    for command in (
        lambda m: m.move_to(0.1), lambda m: m.home(), lambda m: m.jog(0.1), Master.halt,
        Master.resume,
    ):
        with pytest.raises(
            NoPower, match=r"no power; x: statusword .*; it needs enable\(\) first"
        ) as e:
            command(bench.master)
        assert isinstance(e.value, RuntimeError)
        assert e.value.state == State.SWITCH_ON_DISABLED
    assert bench.drive.state == State.SWITCH_ON_DISABLED


def test_what_a_drive_cannot_do_is_refused_in_words(bench):
    positioning(bench)
    master = bench.referenced()
    with pytest.raises(Refused, match=r"x: 0.7 m is beyond the stroke 0..0.5 m \(soft.* 607Dh\)"):
        master.move_to(0.7)
    with pytest.raises(Refused, match="move_to: inf is not a finite number"):
        master.move_to(float("inf"))
    with pytest.raises(Refused, match=r"move_to: \{'y': 0.2\}; give one value for each of \['x'\]"):
        master.move_to({"y": 0.2})
    with pytest.raises(Refused, match=r"mode \w+: drive '\w+' of x does not have it") as e:
        master.set_mode(next(iter(set(Mode) - {Mode.NONE} - {*bench.drive.model.modes}), None)
                        or pytest.skip("it has all modes"))
    assert isinstance(e.value, ValueError)
    assert bench.place == pytest.approx(HERE, abs=NEAR)


def test_an_abort_of_the_drive_is_the_cause_of_a_refusal(bench):
    name = "homing_method" if bench.positions else "digital_inputs"
    with pytest.raises(Refused, match=f"{name} = 99: x: ") as e:
        bench.master.write(name, 99)
    assert isinstance(e.value.__cause__, SdoAbort)
    with pytest.raises(Refused, match="nonsense"):
        bench.master.read("nonsense")


def test_what_does_not_come_tells_what_is_missing(bench):
    bench.drive.axis.sto_input = 0
    with pytest.raises(
        Timeout, match=r"enable: not within 0.1 s; x: statusword .*SWITCH_ON_DIS"
    ) as e:
        bench.master.enable(timeout=0.1)
    assert isinstance(e.value, TimeoutError)
    assert e.value.next_step


def test_a_homing_that_fails_says_so(bench):
    positioning(bench)
    bench.master.enable()
    bench.drive.inject("index_missing")
    bench.master.write("speed_during_search_for_zero", 100_000)
    with pytest.raises(HomingFailed, match=r"homing failed: .*x: statusword .*homing_error") as e:
        bench.master.home(1)
    assert isinstance(e.value, RuntimeError)
    assert not int(bench.drive.read("controlword")) & 0x10, "the start bit has been taken back"
    bench.drive.clear_injected()
    bench.master.reset_fault()  # to some models it is a fault
    bench.master.enable()


@pytest.mark.parametrize("error", [DriveFault, HomingFailed, Interlock, NoPower, Refused, Timeout])
def test_errors_keep_what_they_carry_when_they_are_pickled(error):
    status = (Status("x", 0x0237, 0x000F, 6),)
    told = pickle.loads(pickle.dumps(error("homing", "no answer", "look", status)))
    assert isinstance(told, ServoError)
    assert (told.expected, told.received, told.next_step) == ("homing", "no answer", "look")
    assert (told.status, told.state, told.statusword) == (status, State.OPERATION_ENABLED, 0x0237)
    assert str(told).startswith("homing: no answer; x: statusword 0237h OPERATION_ENABLED")
