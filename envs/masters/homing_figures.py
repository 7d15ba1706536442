"""Figures of a homing run by an agent or by a method of the drive: error, torque, impact.

A drive only finds its home as its sensors allow. The simulation knows the true position of the
axis, and of the edge, the index pulse or the stop that a method looks for. One function measures
agents and built-in methods, so their figures can be compared.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from ...drive.kernel.encoder import Event
from ...drive.kernel.homing import END, HERE, METHODS
from ...drive.kernel.jit import block, entry
from ...drive.kernel.record import accessible
from ...drive.kernel.words import ENABLED, Mode
from ...drive.kernel.words import Controlword as C
from ...drive.kernel.words import Statusword as S
from ...drive.master.master import Master
from ..engine.machine import Machine
from ..engine.tick import axes_at, coordinates, couplings_at, mechanics_at, world_at
from .port import MachinePort

# measured figures; fields with an underscore are set by `prepare`, or belong to the last sample
FIELDS = (
    ("attained", "?"),  # the drive has a reference
    ("error", "f8"),  # home found minus true home (m); 0 before
    ("greatest_torque", "f8"),  # share of the maximum torque
    ("impact_energy", "f8"),  # sum of the impacts on the end stops since the reset (J)
    ("_home", "f8"),  # true home (m)
    ("_full_torque", "f8"),  # maximum torque (Nm)
    ("_position", "f8"),  # m
)
FIGURES = accessible(np.dtype(list(FIELDS), align=True))


class HomingFigures(NamedTuple):
    """Figures of one homing run."""

    method: int
    attained: bool
    error: float  # home found minus true home (m)
    time: float  # s
    greatest_torque: float  # share of the maximum torque
    impact_energy: float  # J
    index_near: bool  # the drive warns that home may jump by a turn


@block
def measure(world, figures):
    """Update the figures of the first axis of a machine."""
    axis = axes_at(world.axes, world.drives)[0]
    coupling = couplings_at(world.couplings, world.drives)[0]
    position = coordinates(world)[coupling.qpos]
    share = abs(axis.torque) / figures._full_torque
    figures.greatest_torque = max(figures.greatest_torque, share)
    figures.impact_energy = mechanics_at(world.mechanics, world.drives)[0].impact_sum
    figures._position = position
    figures.attained = axis.homed != 0
    if figures.attained:
        zero = axis.zero_counts * axis.rad_per_increment
        figures.error = (zero - axis.home_offset) / coupling.gear - figures._home


@entry
def look(worlds, figures):
    """Call `measure` from Python for several machines."""
    for w in range(len(worlds)):
        measure(world_at(worlds[w], 1)[0], figures[w])


def prepare(machine: Machine, figures: np.record, home: float) -> None:
    """Set the data that `measure` needs; `home` is the true home (m). Step the drive before."""
    coupling, axis = machine.couplings[0], machine.axes[0]
    figures._home = home
    figures._full_torque = axis.rated_torque * int(axis.od.max_torque) * 1e-3
    figures._position = machine.data.qpos[coupling.qpos]


def true_home(machine: Machine, method: int, start: float = 0.0) -> float:
    """Return the position at which an ideal run of a homing method finds its home (m).

    Args:
        machine: the machine, whose first axis is homed with the present switches.
        method: a searching method of its drive, see `DriveModel.search`.
        start: start of the run (m), which matters for methods 33 and 34 only.

    Raises:
        ValueError: the method does not search, as 35 and 37.
    """
    (drive, *_) = machine.drives.values()
    found = drive.model.search(method)
    if found is None:
        raise ValueError(f"method = {method!r} looks for nothing: choose of {sorted(METHODS)}")
    legs = found[2]
    last = next(i for i, leg in enumerate(legs) if leg[3] == END)
    if legs[last][2] != Event.INDEX:
        return _place(machine, legs[last])
    earlier = [leg for leg in legs if leg[3] == last]
    begin = _place(machine, earlier[0]) if earlier else start
    turn = 2 * math.pi / abs(float(machine.couplings[0].gear))
    whole = math.floor if legs[last][0] < 0 else math.ceil
    return whole(begin / turn) * turn


def _place(machine: Machine, leg: tuple[int, ...]) -> float:
    """Position of the event of a leg, in the direction of the leg (m)."""
    direction, _, event, *_ = leg
    coupling = machine.couplings[0]
    if event == Event.STOP:
        return float(machine.mechanics["high" if direction > 0 else "low"][0])
    switch, on = (event - 1) >> 1, bool(event & 1)
    slack = 0.0 if on else float(coupling.switch_hysteresis[switch])
    if on == (direction > 0):
        return float(coupling.switch_from[switch]) - slack
    return float(coupling.switch_to[switch]) + slack


def built_in(
    machine: Machine, method: int, start: float, *, stride: int = 10, timeout: float = 60.0,
    objects: Mapping[str, int] | None = None, observer: Callable[[float], None] | None = None,
) -> HomingFigures:
    """Run a homing method of the drive of a machine with one axis, then restore the machine.

    Args:
        machine: the machine, with the switches, friction and payload of the run.
        method: homing method 6098h of the drive.
        start: joint position at power-on (m).
        stride: position cycles between two samples.
        timeout: time after which the run has failed (s).
        objects: objects written before the run, such as ``speed_during_search_for_switch``, in
            drive units.
        observer: called at the start and at each sample with the time since the start (s).

    Raises:
        ValueError: the drive does not have the method, or it looks for nothing.
    """
    (name,) = machine.drives
    drive = machine.drives[name]
    if method in HERE or method not in drive.model.homing_methods:
        known = [known for known in drive.model.homing_methods if known not in HERE]
        raise ValueError(
            f"method = {method!r} is not a search of drive {drive.model.name!r}, choose of {known}"
        )
    before = machine.snapshot()
    try:
        machine.reset(positions={name: start})
        for object_name, value in (objects or {}).items():
            drive.write(object_name, value)
        drive.write("homing_method", method)
        master = Master(MachinePort(machine))
        master.enable()
        master.set_mode(Mode.HOMING)
        figures = np.zeros(1, FIGURES)
        prepare(machine, figures[0], true_home(machine, method, start))
        began = machine.time
        drive.write("controlword", ENABLED | C.NEW_SET_POINT)
        if observer:
            observer(0.0)
        while not figures[0].attained and machine.time - began < timeout:
            machine.step(stride)
            look(machine.addresses, figures)
            if observer:
                observer(machine.time - began)
            if master.status(S.FAULT) or master.status(S.MODE_13):
                break
        return HomingFigures(
            method, bool(figures[0].attained), float(figures[0].error), machine.time - began,
            float(figures[0].greatest_torque), float(figures[0].impact_energy),
            bool(drive.axis.index_near),
        )
    finally:
        machine.restore(before)
