"""The machine that `servogym serve TASK` serves, on a bus within this process and in lock-step.

Apart from the bus itself a task runs as on a real one: with the same commands on the way to the
start, the same bytes and the same guard, and with rewards from the encoder.
"""

import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ...drive.canopen.frame import Frame
from ...drive.canopen.lockstep import LockStep
from ...drive.ethercat.bus import Bus
from ...drive.ethercat.master import EtherCatMaster
from ...drive.ethercat.segment import Segment
from ...drive.ethercat.slave import Slave
from ...drive.model.model import load
from ..engine.machine import Machine
from ..environment.registry import task
from ..environment.servo_env import ServoEnv
from ..exchange import over_port
from .description import MachineRow
from .machines import made


class _Loop:
    """A bus in memory whose nodes advance by a period with each SYNC, which ends that period."""

    def __init__(self, machine: Machine, period: int):
        self._nodes = LockStep([machine], period)
        self._given: list[Frame] = []
        self._answers: list[Frame] = []

    def now(self) -> float:
        return time.monotonic()

    def exchange(self, frames: Iterable[Frame]) -> list[Frame]:
        self._given, self._answers = [*frames], []
        self._nodes.serve(self, ends=True)
        return self._answers

    def receive(self, time: int) -> list[Frame]:
        return self._given

    def send(self, frame: Frame, time: int) -> None:
        self._answers.append(frame)


def environment(
    name: str, bus: str, drive: str | Path = "generic",
    parameters: Mapping[str, Any] | None = None, home: int | None = None,
    envelopes: over_port.Limits | None = None,
) -> ServoEnv:
    """Return a task on a bus in this process, its machine at power-on.

    Args:
        name: of the task, such as ``LinearAxis-v0``.
        bus: "can" or "ethercat".
        drive: model of its drives.
        parameters: of the environment.
        home: method by which the drives are referenced before the first episode; if not given,
            they are referenced where they stand.
        envelopes: limits of the guard, as `servogym.envs.exchange.over_port.CanDrives` has them.

    Raises:
        ValueError: a drive model without this bus, or what the environment refuses.
    """
    kind, model, given = task(name), load(drive, bus), dict(parameters or {})
    row = MachineRow("memory", bus, task=name, drive=str(drive), parameters=given, node_id=1)
    machine, places = made(row, bus, Path())
    period = round(1e6 * kind.STEP_TIME)
    names = kind.DRIVES or [*machine.drives]
    pace = over_port.LockStep()
    side: over_port.DriveSide
    if bus == "ethercat":
        segment = Segment([Slave(each) for each in machine.drives.values()])
        master = EtherCatMaster(Bus(segment, [machine], "frame"))
        side = over_port.EtherCatDrives(
            master, names, model, envelopes=envelopes, pace=pace
        )
    else:
        nodes = {axis: machine.drives[axis].node_id for axis in names}
        side = over_port.CanDrives(
            _Loop(machine, period), nodes, model, envelopes=envelopes, pace=pace
        )
    env: ServoEnv = kind(model, port=side, **given)
    assert isinstance(env.line, over_port.PortLine)
    env.line.home = home
    if home is None and kind.REFERENCED:
        env.line.home = model.homes_here
        for axis in names:
            machine.drives[axis].write("home_offset", -round(places[axis] * env.units))
    return env
