"""Connects the drives of an environment as slaves: process data travel in EtherCAT frames.

An environment is put on one by a fault of the bus among its `faults`. As long as none happens an
episode is the same as without frames, byte by byte. A frame that is lost leaves the drives with
their last set-points and the agent with its last observation; time passes all the same.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...drive.drive import Drive
from ...drive.ethercat.bus import Bus
from ...drive.ethercat.controller.registers import R
from ...drive.ethercat.faulty import Fault, FaultyBus
from ...drive.ethercat.master import EtherCatMaster
from ...drive.ethercat.segment import Segment
from ...drive.ethercat.slave import Slave
from ..engine import loop, probe
from ..engine.machine import NO_IMAGES, Machine

WATCHDOG_UNIT = 1e-4  # s, of 0420h with the divider of the reset
WATCHDOG = 0.1  # s, of the reset; longer where an agent's step is long
STEPS = 4  # of the agent without outputs, at least, until the watchdog bites
MOST = 0xFFFF


class EtherCatLine:
    """The drives of one environment behind slave controllers in OPERATIONAL.

    A step has two frames of process data: with the set-points (LRW), and for the answers (LRD).

    Args:
        machine: the machine of the environment.
        drives: the drives that its agent commands, with the mapping of the task.
        period: of its steps (s).
        faults: the faults to inject; they start again in each episode.

    Raises:
        ValueError: a drive without EtherCAT, a fault of a slave that is not there.
    """

    def __init__(
        self, machine: Machine, drives: Sequence[Drive], period: float, faults: Sequence[Fault]
    ):
        self._machine = machine
        self._drives = list(drives)
        self._faults = list(faults)
        self._tick = round(machine.cycle_time * 1e9) // machine.physics_steps  # ns
        self._segment = Segment([Slave(drive) for drive in drives])
        self._master = EtherCatMaster(Bus(self._segment))
        self._master.scan()
        watchdog = min(round(max(STEPS * period, WATCHDOG) / WATCHDOG_UNIT), MOST)
        for slave in self._master.slaves:
            slave.write(R.WATCHDOG_TIME, watchdog.to_bytes(2, "little"))
        self._master.to_op()
        self._built = [drive.snapshot() for drive in drives]
        self._operational = self._segment.snapshot(drives=False), self._master.state()
        self._order(0)

    def _order(self, seed: int | np.random.Generator) -> None:
        self._bus = FaultyBus(self._segment, faults=self._faults, seed=seed)
        self._master.wire = self._bus
        self.lost = 0  # frames that did not come back, or were not counted by all slaves

    def begin(self, random: np.random.Generator) -> None:
        """Prepare an episode: slaves in OPERATIONAL, fault counts reset, fault rates by `random`.

        A drive that was without power is what it was when the environment was made.
        """
        happened = zip(self._faults, self._bus.happened, strict=True)
        if any(times and fault.kind == "power_cycle" for fault, times in happened):
            for drive, built in zip(self._drives, self._built, strict=True):
                drive.restore(built)
        segment, master = self._operational
        self._segment.restore(segment)
        self._master.become(master)
        self._order(random)

    def run(self, world: np.ndarray, ticks: int, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Run cycles as `loop.run` does, for one world and its images as bytes."""
        probe.renew(self._machine)
        delay = min(int(self._machine.world["delay"][0]), ticks)
        self._pass(world, delay)
        at = 0
        for slave in self._master.slaves:
            size = len(slave.outputs)
            slave.outputs[:] = rpdos[at : at + size].tobytes()
            at += size
        self.lost += not self._master.cycle()
        self._pass(world, ticks - delay)
        self._segment.publish(self._bus.time)
        if self._master.look():
            inputs = b"".join(slave.inputs for slave in self._master.slaves)
            tpdos[:] = np.frombuffer(inputs, np.uint8)
        else:
            self.lost += 1

    def look(self, world: np.ndarray, rpdos: np.ndarray, tpdos: np.ndarray) -> None:
        """Fill the TPDO images from the drives themselves, without running a cycle."""
        loop.run(world, 0, rpdos[None], tpdos[None])

    def _pass(self, world: np.ndarray, ticks: int) -> None:
        loop.run(world, ticks, NO_IMAGES, NO_IMAGES)
        self._bus.let_pass(ticks * self._tick)

    def state(self) -> tuple[Any, ...]:
        """The state of the line since its creation; the machine stores the state of the drives."""
        segment = self._segment.snapshot(drives=False)
        return segment, self._bus.state(), self._master.state(), self.lost

    def become(self, state: tuple[Any, ...]) -> None:
        """Restore a `state` of an equal line; the machine has already restored the drives."""
        segment, bus, master, self.lost = state
        self._segment.restore(segment)
        self._bus.become(bus)
        self._master.become(master)
