"""Logs of each drive model on each bus: what a master sends in csp, ip or pp, and a logger keeps.

The hidden parameters of a rigid axis are drawn with the seed; the master maps PDOs, sets the mode
and commands moves as a controller does, one process image a bus cycle. 0.5 % of the frames are
missing from the log, their stamps jitter by 0.2 ms. `campaign.py` plays each cell.
"""

import time

import numpy as np
from machines import hide, moves

from servogym.drive.canopen.frame import Base
from servogym.drive.canopen.lockstep import LockStep
from servogym.drive.canopen.remote import SYNC, CanOpenPort
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.port import EtherCatPort
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.kernel.words import ENABLED
from servogym.drive.master.master import Master
from servogym.drive.master.port import Units
from servogym.drive.model.model import load
from servogym.drive.wire.bus import to_message
from servogym.drive.wire.log import LogFile
from servogym.drive.wire.pcapng import Writer
from servogym.envs import linear_axis
from servogym.envs.engine import parameters
from servogym.envs.twin import logs
from servogym.envs.twin.experiment import Scale
from servogym.envs.twin.families import FAMILIES
from servogym.envs.twin.fit import fit

HIDDEN = ("payload", "coulomb_friction", "viscous_friction")
CELLS = (  # model, bus, modes
    ("generic", "can", ("csp", "pp")), ("festo_cmmp_as", "can", ("ip", "pp")),
    ("festo_cmmp_as_m0", "can", ("ip", "pp")), ("festo_cmms", "can", ("ip", "pp")),
    ("festo_cmmd", "can", ("ip", "pp")), ("metronix_ars2000", "can", ("pp",)),
    ("generic", "ethercat", ("csp", "pp")), ("kollmorgen_akd", "ethercat", ("csp", "pp")),
    ("festo_cmmp_as", "ethercat", ("ip", "pp")),
)
MODES = {"pp": 1, "ip": 7, "csp": 8}
SET_POINT = {"pp": "target_position", "ip": "interpolation_data", "csp": "target_position"}
OUTPUTS, INPUTS = ("controlword",), ("statusword", "position_actual_value", "torque_actual_value")
NODE = 1


class Logged:
    """Frames that a logger keeps, its stamps late by up to a jitter, some of them lost.

    Args:
        rng: of both.
        dropped: share of the frames that are missing, once the axis moves.
        jitter: s
    """

    def __init__(self, rng, dropped, jitter):
        self.rng, self.dropped, self.jitter = rng, dropped, jitter
        self.cyclic, self._last = False, 0.0

    def stamp(self, now, often=True):
        """When the logger saw a frame (s), None if it has not; what is not sent `often` it sees."""
        late = 0.0
        if self.cyclic:
            if self.rng.random() < self.dropped * often:
                return None
            late = self.rng.uniform(0, self.jitter)
        self._last = max(self._last + 1e-6, now + late)
        return self._last


class CanBus(Logged):
    """The port of a master that sends a SYNC each period, and its log."""

    def __init__(self, machine, file, period, *logged):
        super().__init__(*logged)
        self.steps = LockStep([machine], round(period * 1e6))
        self._link, self._log = self.steps.bus.join(), LogFile(file)

    def now(self):
        return 1e-6 * self.steps.time

    def _write(self, frame, received):
        stamp = self.stamp(self.now() + 1e-4 * received, frame.id < 0x580)
        if stamp is not None:
            message = to_message(frame)
            message.timestamp, message.is_rx, message.channel = 1e3 + stamp, received, 0
            self._log(message)

    def exchange(self, frames):
        for frame in (*(each for each in frames if each != SYNC), SYNC):
            self._write(frame, False)
            if frame != SYNC:
                self._link.send(frame, self.steps.time)
        self.steps.sync()
        found = [each for each in self._link.receive(self.steps.time) if each.id != Base.SYNC]
        for frame in found:
            self._write(frame, True)
        return found

    def close(self):
        self._log.stop()


class EtherCatBus(Logged):
    """The wire of a master, captured at its interface."""

    def __init__(self, machine, file, period, *logged):
        super().__init__(*logged)
        self.bus = Bus(Segment([Slave(drive) for drive in machine.drives.values()]), [machine])
        self._log = Writer(file)

    @property
    def time(self):
        return self.bus.time

    def _write(self, frame, now):
        stamp = self.stamp(now)
        if stamp is not None:
            self._log.write(frame, 10**18 + round(1e9 * stamp))

    def exchange(self, frame, now=0):
        sent = 1e-9 * self.bus.time
        self._write(frame, sent)
        reply = self.bus.exchange(frame)
        if reply is not None:
            self._write(reply, sent + 3e-5)
        return reply

    def close(self):
        self._log.close()


def mapped(node, names, communication, mapping, cob_id):
    """PDOs of a CANopen node, filled one after the other."""
    rows, first = [node._model.number(name) for name in names], 0
    for n in range(4):
        share, size = [], 0
        while first < len(rows) and size + rows[first].size <= 8:
            share.append(rows[first])
            size += rows[first].size
            first += 1
        put = node.sdo.download
        here = cob_id + 0x100 * n + NODE
        put(communication + n, 1, (0x80000000 | here).to_bytes(4, "little"))
        if not share:
            continue
        put(mapping + n, 0, b"\0")
        for k, row in enumerate(share, 1):
            word = row.index << 16 | row.subindex << 8 | 8 * row.size
            put(mapping + n, k, word.to_bytes(4, "little"))
        put(mapping + n, 0, bytes([len(share)]))
        put(communication + n, 2, b"\1")
        put(communication + n, 1, here.to_bytes(4, "little"))


def record(machine, file, rng, mode, period, *, fieldbus="can", name="x", dropped=0.005,
           jitter=2e-4, noise=0.5e-6, seconds=4.0, low=0.05, high=0.45):
    """Moves of one axis, commanded over a bus; -> its log, candump or pcapng."""
    drive, cycle = machine.drives[name], machine.cycle_time
    period = round(period / cycle) * cycle  # of an ARS 2000 0.832 ms, 9.984 ms
    parameters.apply(machine, {"encoder_noise": noise}, name)
    machine.couplings["noise_state"] = int(rng.integers(1, 2**62))
    here = 0.5 * (low + high)
    if mode == "ip":  # saved, and the drive reset: some take another period then only (Festo 7.4.2)
        drive.commission({"interpolation_time_index": -3})
        drive.commission({"interpolation_time_period_value": round(period * 1e3)})
    machine.reset({name: here})
    machine.step()
    gear = machine.joint(name)[0]
    wanted = round(here * gear / float(drive.axis.rad_per_increment))
    drive.axis.zero_counts, drive.axis.homed = int(drive.axis.counts) - wanted, 1
    drive.commission({"following_error_window": 2**31 - 1})
    machine.step()
    unit = Scale.of(machine, name).position
    outputs = (*OUTPUTS, SET_POINT[mode])
    if fieldbus == "can":
        bus = CanBus(machine, file, period, rng, dropped, jitter)
        port = CanOpenPort(bus, {name: NODE}, drive.model, units=Units(unit, 1.0, "m"))
        node = port.nodes[name]
        mapped(node, outputs, 0x1400, 0x1600, 0x200)
        mapped(node, INPUTS, 0x1800, 0x1A00, 0x180)
        node.use_pdos()
    else:
        bus = EtherCatBus(machine, file, period, rng, dropped, jitter)
        port = EtherCatPort(EtherCatMaster(bus), {name: drive.model}, outputs=outputs,
                            inputs=INPUTS, units=Units(unit, 1.0, "m"))
    if mode != "pp" or fieldbus == "ethercat":  # there it is the period of the bus in memory too
        port.write(name, "interpolation_time_index", -3)
        port.write(name, "interpolation_time_period_value", round(period * 1e3))
    if mode == "ip" and "buffer_clear" in drive.model.names:
        port.write(name, "buffer_clear", 1)
    master = Master(port)
    port.write(name, "modes_of_operation", MODES[mode])
    port.write(name, SET_POINT[mode], round(here / unit))
    for _ in range(5):
        port.exchange()
    master.enable()
    bus.cyclic = True
    if mode == "pp":
        begin = port.now()
        while port.now() - begin < seconds:
            speed, acceleration = rng.uniform(0.1, 0.7), rng.uniform(2, 8)
            per_second = float(drive.axis.rad_s_per_velocity_unit) / gear
            per_second_2 = float(drive.axis.rad_s2_per_acceleration_unit) / gear
            port.write(name, "profile_velocity", round(speed / per_second))
            for which in ("profile_acceleration", "profile_deceleration"):
                port.write(name, which, round(acceleration / per_second_2))
            master.move_to(rng.uniform(low, high))
            for _ in range(round(0.06 / period)):
                port.exchange()
    else:
        for place in moves(rng, seconds, period, low=low, high=high):
            port.write(name, "controlword", ENABLED | (0x10 if mode == "ip" else 0))
            port.write(name, SET_POINT[mode], round(place / unit))
            port.exchange()
    bus.close()
    return file


def cell(model, fieldbus, mode, period, seed, folder, known=True):
    """One machine: its log's twin, what was hidden, the twin's own noise floor (m), CPU-s."""
    rng = np.random.default_rng(seed)
    machine = linear_axis(load(model, fieldbus))
    hidden = hide(machine, rng, HIDDEN)
    suffix = {"can": "log", "ethercat": "pcapng"}[fieldbus]
    file = folder / f"{model}-{fieldbus}-{mode}-{round(1e3 * period)}.{suffix}"
    record(machine, file, rng, mode, period, fieldbus=fieldbus)
    begin = time.process_time()
    rigid = FAMILIES["rigid"]
    (found,) = logs.read([file], rigid.make(model), model, "x")
    twin = fit([found], model, rigid, gains_known=known)
    return twin, hidden, twin.floor_position, time.process_time() - begin
