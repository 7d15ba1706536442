"""The services of one drive behind a slave controller: AL states, mailbox, PDO assignment.

The controller exchanges process data and keeps the clocks. It reports events to the services, which
answer at once through its process data interface.
"""

import ast
from collections.abc import Mapping
from typing import Any

from ..drive import Drive
from ..model.given import whole
from ..model.model import load
from ..objects.snapshot import seal, unseal
from . import eoe, sii
from .al import WITH_INPUTS, WITH_MAILBOX, AlMachine, AlState, AlStatusCode
from .coe import Coe, Emergencies, Sdo
from .controller.pdi import IN, OUT, Pdi
from .controller.process_image import INPUTS, OUTPUTS, ProcessImage
from .controller.record import Event, SyncMode
from .controller.registers import R
from .foe import File, Foe
from .mailbox import HEADER, Answer, Kind, Mailbox, MailboxError, Service
from .sdo_info import SdoInfo

PARAMETERS = "parameters"  # name of the parameter file in FoE
DIRECTION = 0x0C  # bits of the control byte of a sync manager
WRITTEN_BY_MASTER = 0x04
SYNC_ACTIVE = 0x03  # 0981h: cyclic operation and SYNC0
SYNC_UNIT = 0x07  # bits of 0981h that the operation modes name
ERROR_LIMIT = (0x10F1, 2)  # sync error counter limit
COPY_TIME = (0x1C32, 6)  # calculation and copy time (ns)


def interpolation_ns(drive: Drive) -> int:
    """The period 60C2h (ns)."""
    od, n = drive.axes["od"], drive.index  # the array of all axes, because making a record is slow
    units, index = od["interpolation_time_units"][n], od["interpolation_time_index"][n]
    return round(int(units) * 10.0 ** (9 + int(index)))


class Slave:
    """A drive on an EtherCAT segment.

    Args:
        drive: the drive, made for this bus: ``Drive(model, bus="ethercat")``.
        alias: station alias in the EEPROM; by default the one that a master wrote last.

    Raises:
        ValueError: the drive is on another bus, its SII does not fit, or the alias is out of range.
    """

    def __init__(self, drive: Drive, *, alias: int | None = None):
        load(drive.model, "ethercat")  # refuses a model without EtherCAT
        if drive.model.ethercat is None:
            raise ValueError(
                f"drive {drive.model.name!r} is on {drive.model.bus}: "
                f'make it with Drive({drive.model.name!r}, bus="ethercat")'
            )
        self.drive = drive
        self.data = data = drive.model.ethercat
        if alias is None:
            alias = drive.parameters.alias
        whole("alias", alias, 0, 0xFFFF)
        self.sii = sii.of_model(drive.model, alias)
        self.esc = data.registers
        self.al = AlMachine(data.al, self._check, self._entered, lambda: self._identification)
        self._identification = alias
        self._sdo = Sdo(drive.objects, data.complete_access)
        self._foe = Foe({PARAMETERS: File(drive.parameters.export, drive.parameters.take)})
        coe = Coe(self._sdo, SdoInfo(drive.model) if data.information else None)
        services = {"CoE": coe.request, "FoE": self._foe.request, "EoE": eoe.request}
        self._offered: dict[int, Service] = {
            Kind[name.upper()]: services.get(name, _refuse) for name in data.protocols
        }
        self.mailbox = Mailbox(self._offered)
        self.emergencies = Emergencies(drive)
        self._parts: tuple[Any, ...] = (
            self.al, self.mailbox, self._sdo, self._foe, self.emergencies
        )
        self._pdi: Pdi
        self._image: ProcessImage
        self._on = False

    # ------------------------------------------------------------------ power

    def attach(self, pdi: Pdi, image: ProcessImage) -> None:
        """Connect the services to their controller."""
        self._pdi, self._image = pdi, image
        self.drive.synchronisation = self._synchronisation

    def _synchronisation(self) -> Mapping[int, int]:
        """Values of 1C32h and 1C33h by sub-index (ETG.1020); those missing are 0."""
        esc, sync0_ns = self._image.esc, self._pdi.get(R.SYNC0_CYCLE, 4)
        with_sync0 = esc.sync_mode == SyncMode.SYNC0
        return {
            0x01: esc.sync_mode,
            0x02: sync0_ns if with_sync0 else interpolation_ns(self.drive),
            0x0A: sync0_ns,
            0x0B: esc.sync_errors,
            0x0C: esc.cycle_exceeded,
            0x0D: esc.shift_short,
            0x20: esc.outputs_late > 0,
        }

    def power_on(self) -> None:
        """Begin in INIT; every power-on but the first one resets the drive as well."""
        if self._on:
            self.drive.reset()
        self._on = True
        self._identification = self._pdi.alias
        self.al.power_on()
        self._quiet()
        self._image.outputs(False)
        self._image.inputs(False)
        self.drive.operational = False
        self._tell_state()

    @property
    def state(self) -> AlState:
        """State of the AL state machine."""
        return self.al.state

    def fail(self, code: int, state: AlState = AlState.SAFE_OPERATIONAL) -> None:
        """Show an AL status code, and retreat to `state` if it is lower than the present one.

        Raises ValueError for a code of more than 16 bits, or an unknown state.
        """
        whole("code", code, 0, 0xFFFF)
        self.al.fail(code, min(AlState(state), self.al.state))
        self._tell_state()

    # ----------------------------------------------------------------- events

    def serve(self, events: int, now: int) -> None:
        """Process events (bits of `Event`) at `now` (ns)."""
        if events & Event.EEPROM:
            self._keep_alias()
        if events & Event.AL_CONTROL:
            self.al.control(self._pdi.al_control())
            self._tell_state()
        if events & Event.SYNC and self.state in WITH_INPUTS:
            self._check_running_clock()
        if self.state == AlState.OPERATIONAL:
            if events & Event.WATCHDOG:
                self.fail(AlStatusCode.WATCHDOG)
            elif events & Event.SYNC_LOST:
                self.fail(AlStatusCode.SYNCHRONISATION_ERROR)
        if events & Event.MAILBOX_READ:
            self.mailbox.fetched()
        self._serve_mailbox(events)

    def _serve_mailbox(self, events: int) -> None:
        if self.state not in (*WITH_MAILBOX, AlState.BOOTSTRAP):
            return
        if events & Event.REPEAT and self._pdi.repeat:
            self._pdi.mailbox_repeat(self.mailbox.again())
        if self.mailbox.ready:
            for body in self.emergencies.bodies():
                if Kind.COE in self.mailbox.services:
                    self.mailbox.post(Kind.COE, body)
        while self.mailbox.ready and (buffer := self._pdi.mailbox_take()):
            before = self.drive.communication_version
            self.mailbox.receive(buffer)
            if self.drive.communication_version != before:
                self._image.prepare()
        telegram = self.mailbox.next()
        if telegram and self._pdi.mailbox_put(telegram):
            self.mailbox.sent()

    def _tell_state(self) -> None:
        self._pdi.al_status(self.al.status, self.al.code)

    # -------------------------------------------------------------- AL states

    def _check(self, before: AlState, after: AlState) -> AlStatusCode:
        """Check sync managers and SYNC unit before a transition to a higher state."""
        if before == AlState.INIT:
            boot = after == AlState.BOOTSTRAP
            wanted = self.data.bootstrap if boot else self.data.mailbox
            right = self._is_mailbox(OUT, *wanted[:2]) and self._is_mailbox(IN, *wanted[2:])
            wrong = AlStatusCode.INVALID_MAILBOX_BOOTSTRAP if boot else AlStatusCode.INVALID_MAILBOX
            return AlStatusCode.NO_ERROR if right else wrong
        if before == AlState.PRE_OPERATIONAL:
            if not self._is_buffer(OUTPUTS, self.data.start[0], self.drive.rpdo_size):
                return AlStatusCode.INVALID_OUTPUTS
            if not self._is_buffer(INPUTS, self.data.start[1], self.drive.tpdo_size):
                return AlStatusCode.INVALID_INPUTS
            return self._check_clock()
        if self._image.esc.sync_mode == SyncMode.SYNC0 and not self._sync0_on:
            return AlStatusCode.NO_SYNC_ERROR
        return AlStatusCode.NO_ERROR

    def _is_mailbox(self, number: int, start: int, length: int) -> bool:
        manager = self._pdi.sync_manager(number)
        fits = min(self.data.shortest, length) <= manager.length <= length
        return manager.enabled and manager.start == start and fits

    def _is_buffer(self, number: int, start: int, length: int) -> bool:
        manager = self._pdi.sync_manager(number)
        if not length:
            return not manager.enabled or not manager.length
        by_master = manager.control & DIRECTION == WRITTEN_BY_MASTER
        fits = (manager.start, manager.length) == (start, length)
        return manager.enabled and fits and by_master == (number == OUTPUTS)

    def _check_clock(self) -> AlStatusCode:
        """Check whether the model can follow the SYNC unit as the master has set it."""
        active = self._pdi.get(R.ACTIVATION, 1) & SYNC_UNIT
        if not active & 1:
            return AlStatusCode.NO_ERROR
        if active not in {mode.assign_activate >> 8 & SYNC_UNIT for mode in self.data.modes}:
            return AlStatusCode.INVALID_DC_SYNC
        cycle = self._pdi.get(R.SYNC0_CYCLE, 4)
        if not cycle or cycle % self.data.cycle_ns:
            return AlStatusCode.DC_CYCLE_TIME
        if self.data.exact_period and cycle != interpolation_ns(self.drive):
            return AlStatusCode.DC_CYCLE_TIME
        return AlStatusCode.NO_ERROR

    @property
    def _sync0_on(self) -> bool:
        return self._pdi.get(R.ACTIVATION, 1) & SYNC_ACTIVE == SYNC_ACTIVE

    def _check_running_clock(self) -> None:
        """Retreat if a master changes the SYNC unit of a drive that runs with SYNC0 (inferred).

        If SYNC0 is off, the drive retreats to SAFE_OP (ETG.1020, no sync error). If it cannot
        follow the new settings, it retreats to PRE_OP, where a master sets them.
        """
        if self._image.esc.sync_mode != SyncMode.SYNC0:
            return
        if not self._sync0_on:
            if self.state == AlState.OPERATIONAL:
                self.fail(AlStatusCode.NO_SYNC_ERROR)
        elif code := self._check_clock():
            self.fail(code, AlState.PRE_OPERATIONAL)

    def _entered(self, before: AlState, after: AlState) -> None:
        """Switch services and process data on or off after a transition."""
        self.drive.operational = after in WITH_INPUTS
        if before == AlState.INIT:
            self._begin_mailbox(after)
        elif after == AlState.INIT:
            self._quiet()
        if before == AlState.PRE_OPERATIONAL and after == AlState.SAFE_OPERATIONAL:
            esc, value = self._image.esc, self.drive.objects.value
            esc.sync_mode = SyncMode.SYNC0 if self._sync0_on else SyncMode.SM_EVENT
            own = self.data.error_settings
            esc.late_limit = value(*ERROR_LIMIT) if own else self.data.late_limit
            esc.cycle_ns, esc.copy_ns = self.data.cycle_ns, value(*COPY_TIME)
        if (before in WITH_INPUTS) != (after in WITH_INPUTS):
            self._image.inputs(after in WITH_INPUTS)
        if AlState.OPERATIONAL in (before, after):
            self._image.outputs(after == AlState.OPERATIONAL)
            # 6007h concerns a drive that loses its master while it is energised
            lost = after != AlState.OPERATIONAL and self.drive.energised
            self.drive.axis.connection_lost = lost

    def _begin_mailbox(self, state: AlState) -> None:
        """Open the mailbox for the services of a state."""
        self._quiet()
        self.mailbox.services = self._services(state)
        self.mailbox.size = self._pdi.sync_manager(IN).length - HEADER.size

    def _services(self, state: AlState) -> dict[int, Service]:
        """The services of a state; in BOOTSTRAP there is only FoE."""
        boot = state == AlState.BOOTSTRAP
        return {k: take for k, take in self._offered.items() if k == Kind.FOE or not boot}

    def _quiet(self) -> None:
        self.mailbox.reset()
        self._sdo.reset()
        self._foe.reset()
        self.emergencies.reset()
        self._pdi.mailboxes_reset()

    # ------------------------------------------------------- what is kept

    def _keep_alias(self) -> None:
        """Store the station alias that a master has written, if the checksum is right."""
        alias = sii.alias_of(self._pdi.sii)
        if alias is not None and alias != self.drive.parameters.alias:
            self.drive.parameters.keep_alias(alias)

    # ------------------------------------------------------------- snapshot

    def snapshot(self) -> bytes:
        """Return AL state, waiting telegrams and transfers in progress, for `restore`."""
        parts = [[getattr(part, name) for name in part.KEPT] for part in self._parts]
        state = int(self.state), parts, self._identification, self.drive.operational
        return seal(self._kind, {}, [repr(state).encode()])

    @property
    def _kind(self) -> dict[str, Any]:
        return {"kind": "slave", "model": self.drive.model.name}

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot.

        Raises:
            ValueError: not a snapshot, damaged, or of another model; nothing is changed.
        """
        _, (state,) = unseal(snapshot, self._kind, {}, [None])
        al, parts, self._identification, self.drive.operational = ast.literal_eval(state.decode())
        self.al.state = AlState(al)
        for part, values in zip(self._parts, parts, strict=True):
            for name, value in zip(part.KEPT, values, strict=True):
                setattr(part, name, value)
        self.mailbox.services = self._services(self.al.state)


def _refuse(body: bytes, size: int) -> Answer:
    """Refuse a protocol that the device announces but that is not implemented."""
    return MailboxError.SERVICE_NOT_SUPPORTED
