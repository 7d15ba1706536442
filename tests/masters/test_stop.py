"""A stop stands in every mode, with every model, on every port; MuJoCo says where the axis is."""

from contextlib import suppress

import pytest
from masters.ports import CASES, axis

from servogym.drive.kernel.words import ENABLED, Mode, State
from servogym.drive.master import Master, NoPower, Refused, Timeout

HERE = 0.12  # m
STILL = 2e-3  # m, the axis may settle by after a stop
FAST = 0.05  # m/s, before the stop
MOVING = (
    Mode.PROFILE_POSITION, Mode.VELOCITY, Mode.PROFILE_VELOCITY, Mode.PROFILE_TORQUE, Mode.HOMING,
    Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNC_POSITION, Mode.CYCLIC_SYNC_VELOCITY,
    Mode.CYCLIC_SYNC_TORQUE,
)


class Bench:
    """An axis that runs in a mode."""

    def __init__(self, model, bus, port):
        self.machine = axis(model, bus)
        self.drive = self.machine.drives["x"]
        self.master = Master(port(self.machine))
        if Mode.PROFILE_POSITION not in self.drive.model.modes:
            for data_set in (1, 2, 3, 4):
                self.drive.write(0x219C, data_set, 1)  # commanded by the bus, not by contacts

    @property
    def place(self):
        return float(self.machine.data.qpos[0])

    @property
    def speed(self):
        return float(self.machine.data.qvel[0])

    def run_in(self, mode):
        """Set out in a mode, by set-points as any master sends them, until the axis is fast."""
        master, port = self.master, self.master.port
        master.enable()
        unit = port.units("x")
        if Mode.HOMING in self.drive.model.modes and mode != Mode.HOMING:
            master.write("home_offset", round(-HERE * 1e6))
            master.home(self.drive.model.homes_here)
        if mode == Mode.HOMING:
            master.set_mode("hm")
            master.write("homing_method", 17)
            master.control(ENABLED)
            master.control(ENABLED | 0x10)
        elif mode == Mode.PROFILE_POSITION:
            master.move_to(0.45, wait=False)
        else:
            if mode in (Mode.CYCLIC_SYNC_POSITION, Mode.INTERPOLATED_POSITION):
                master.write("target_position", port.read("x", "position_actual_value"))
            if mode == Mode.INTERPOLATED_POSITION:
                master.write("interpolation_data", port.read("x", "position_actual_value"))
                if "buffer_clear" in self.drive.model.names:
                    master.write("buffer_clear", 1)
            master.set_mode(mode)
            master.control(ENABLED | (0x70 if mode == Mode.VELOCITY else 0x10))
        begin = port.now()
        at = 0 if mode == Mode.VELOCITY else port.read("x", "position_actual_value")
        while abs(self.speed) < FAST:
            passed = port.now() - begin
            assert passed < 5.0, f"{mode.name}: {self.speed} m/s, {master.describe()}"
            target = at + round(0.2 * passed / unit.position)
            point = {
                Mode.VELOCITY: ("vl_target_velocity", 200),
                Mode.PROFILE_VELOCITY: ("target_velocity", round(0.2 / unit.velocity)),
                Mode.CYCLIC_SYNC_VELOCITY: ("target_velocity", round(0.2 / unit.velocity)),
                Mode.PROFILE_TORQUE: ("target_torque", 110),
                Mode.CYCLIC_SYNC_TORQUE: ("target_torque", 110),
                Mode.CYCLIC_SYNC_POSITION: ("target_position", target),
                Mode.INTERPOLATED_POSITION: ("interpolation_data", target),
            }.get(mode)
            if point:
                master.write(*point)
            else:
                port.exchange()


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]}-{case[1]}-{case[2].__name__}")
def test_a_stop_stands_in_every_mode(case):
    bench = Bench(*case)
    for mode in MOVING:
        if mode not in bench.drive.model.modes:
            continue
        if mode == Mode.INTERPOLATED_POSITION and bench.drive.model.quirk("ip_needs_sync"):
            continue  # none of these ports sends SYNC
        bench = Bench(*case)
        bench.run_in(mode)
        with suppress(Timeout):  # only its torque was taken away: a quick stop follows
            assert bench.master.stop() == ("x",)
        bench.master.wait(0.5)
        stopped = bench.place
        for _ in range(4):
            bench.master.wait(0.25)
            assert bench.place == pytest.approx(stopped, abs=STILL), mode.name
        assert abs(bench.speed) < 5e-3, mode.name


def test_what_was_stopped_does_not_begin_again_with_the_next_command():
    """Halt taken back with an old target would: each mode after each."""
    memory = next(case for case in CASES if case[0] == "generic" and case[2].__name__ == "memory")
    for mode in MOVING:
        bench = Bench(*memory)
        bench.run_in(mode)
        bench.master.stop()
        stopped = bench.place
        bench.master.resume()
        bench.master.wait(1.0)
        assert bench.place == pytest.approx(stopped, abs=STILL), mode.name
        if mode == Mode.HOMING:
            continue
        bench.master.move_to(0.2)  # the next command is obeyed
        assert bench.place == pytest.approx(0.2, abs=1e-4), mode.name


def test_a_stop_without_power_switches_none_on():
    bench = Bench(*CASES[0])
    bench.master.control(0x06)
    bench.master.control(0x07)
    bench.machine.step(4)
    assert bench.master.stop() == ()
    assert bench.drive.state is State.SWITCHED_ON


@pytest.mark.parametrize("stop", ["stop", "halt", "quick_stop", "disable"])
def test_one_drive_that_does_not_hear_keeps_no_other_from_stopping(stop):
    from servogym.envs import gantry
    from servogym.envs.masters.port import MachinePort

    class Deaf(MachinePort):
        """One drive of the port hears nothing any more."""

        deaf = ""

        def upload(self, name, what):
            if name == self.deaf:
                raise Timeout("SDO", "no answer")
            return super().upload(name, what)

        read = upload

        def write(self, name, what, value):
            if name == self.deaf:
                raise Timeout("SDO", "no answer")
            super().write(name, what, value)

    for deaf in ("x", "y"):
        machine = gantry()
        machine.reset()
        port = Deaf(machine)
        master = Master(port, "x", "y")
        master.enable()
        master.set_mode("pv")
        for name in ("x", "y"):
            master[name].jog(0.05)
        port.deaf, other = deaf, {"x": "y", "y": "x"}[deaf]
        with pytest.raises(Timeout):
            getattr(master, stop)()
        machine.step(4000)
        (coupling,) = (
            c for n, c in zip(machine.drives, machine.couplings, strict=True) if n == other
        )
        assert abs(machine.data.qvel[coupling.dof]) < 2e-3


def test_a_mode_goes_by_its_abbreviation_and_a_wrong_one_has_near_names():
    bench = Bench(*CASES[0])
    bench.master.set_mode("csp" if Mode.CYCLIC_SYNC_POSITION in bench.drive.model.modes else "vl")
    with pytest.raises(Refused, match="did you mean"):
        bench.master.set_mode("homming")


def test_halt_of_two_with_one_unpowered_stops_the_other_and_says_so():
    from servogym.envs import gantry
    from servogym.envs.masters.port import MachinePort

    machine = gantry()
    machine.reset()
    master = Master(MachinePort(machine), "x", "y")
    master["y"].enable()
    master["y"].jog(0.1)
    with pytest.raises(NoPower, match="halt"):
        master.halt()
    machine.step(2000)
    assert machine.drives["y"].axis.standstill
