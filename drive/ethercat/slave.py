"""The services of one drive behind a slave controller: AL states, mailbox, PDO assignment.

Here is what a slave does now and then; process data and clocks are the controller's. It is told of
events and answers at once, through the process data interface of its controller.
"""

import ast
from typing import Any

from ..drive import Drive
from ..model.given import whole
from ..model.model import load
from ..objects.snapshot import seal, unseal
from . import sii
from .al import WITH_INPUTS, WITH_MAILBOX, AlMachine, AlRules, AlState, AlStatusCode
from .coe import Coe, Emergencies, Sdo
from .controller.pdi import IN, OUT, Pdi
from .controller.process_image import INPUTS, OUTPUTS, ProcessImage
from .controller.record import Event, SyncMode
from .controller.registers import R
from .eoe import Eoe
from .foe import File, Foe
from .mailbox import HEADER, Answer, Kind, Mailbox, MailboxError, Service
from .sdo_info import SdoInfo

PARAMETERS = "parameters"  # name of the parameter file in FoE
DIRECTION = 0x0C  # bits of the control byte of a sync manager
WRITTEN_BY_MASTER = 0x04
SYNC_ACTIVATION = 0x0981
SYNC_ACTIVE = 0x03  # 0981h: cyclic operation and SYNC0
SYNC_UNIT = 0x07  # bits of 0981h that the operation modes name
ERROR_LIMIT = (0x10F1, 2)  # sync error counter limit
COPY_TIME = (0x1C32, 6)  # calculation and copy time (ns)


class Synchronisation:
    """What 1C32h and 1C33h show of a slave."""

    def __init__(self, pdi: Pdi, image: ProcessImage, drive: Drive):
        self._pdi = pdi
        self._image = image
        self._drive = drive
        self.shift_ns = 0

    @property
    def sync_type(self) -> int:
        """0 free run, 1 with SM 2, 2 with SYNC0."""
        return int(self._image.sync_mode)

    @property
    def sync0_ns(self) -> int:
        """Period of SYNC0."""
        return self._pdi.get(R.SYNC0_CYCLE, 4)

    @property
    def cycle_ns(self) -> int:
        """Period in which outputs are taken over: of SYNC0, else the one that 60C2h announces."""
        if self.sync_type == SyncMode.SYNC0:
            return self.sync0_ns
        return interpolation_ns(self._drive)

    @property
    def events_missed(self) -> int:
        """Edges without new outputs."""
        return min(self._image.sync_errors, 0xFFFF)

    @property
    def cycle_exceeded(self) -> int:
        """Outputs that came before the cycle of those before was over."""
        return self._image.cycle_exceeded

    @property
    def shift_too_short(self) -> int:
        """Edges for which outputs had come too late to be copied."""
        return self._image.shift_short

    @property
    def sync_error(self) -> bool:
        """Whether the last edge of SYNC0 had no new outputs."""
        return self._image.late


def interpolation_ns(drive: Drive) -> int:
    """The period 60C2h (ns)."""
    od, n = drive.axes["od"], drive.index  # of all axes: a record of one is slow to make
    units, index = od["interpolation_time_units"][n], od["interpolation_time_index"][n]
    return round(int(units) * 10.0 ** (9 + int(index)))


class Slave:
    """A drive on an EtherCAT segment.

    Args:
        drive: the drive, made for this bus: ``Drive(model, bus="ethercat")``.
        alias: station alias in the EEPROM; without one that which a master has written before.

    Raises:
        ValueError: the drive is on another bus, its SII does not fit, the alias is not an alias.
    """

    def __init__(self, drive: Drive, *, alias: int | None = None):
        load(drive.model, "ethercat")  # refuses a model that has no such face
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
        rules = AlRules(
            data.al.bootstrap, data.al.by_edge, data.al.init_acknowledges, data.al.codes
        )
        self.al = AlMachine(rules, self._check, self._entered, lambda: self._identification)
        self._identification = alias
        self._sdo = Sdo(drive.objects, data.complete_access)
        self._foe = Foe({PARAMETERS: File(self._parameters, self._take_parameters)})
        self._eoe = Eoe()
        self._coe = Coe(self._sdo, SdoInfo(drive.model) if data.information else None)
        self._offered: dict[int, Service] = {
            Kind[name.upper()]: {
                "CoE": self._coe.request,
                "FoE": self._foe.request,
                "EoE": self._eoe.request,
            }.get(name, _refuse)
            for name in data.protocols
        }
        self.mailbox = Mailbox(self._offered)
        self.emergencies = Emergencies(drive)
        self._pdi: Pdi
        self._image: ProcessImage
        self._on = False

    # ------------------------------------------------------------------ power

    def attach(self, pdi: Pdi, image: ProcessImage) -> None:
        """Take over the controller."""
        self._pdi, self._image = pdi, image
        self.drive.synchronisation = Synchronisation(pdi, image, self.drive)

    def power_on(self) -> None:
        """Begin in INIT; the drive is reset as well, unless it has been made for this moment."""
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

    def fail(self, code: AlStatusCode | int, state: AlState = AlState.SAFE_OPERATIONAL) -> None:
        """Retreat to `state` with a status code; without a retreat the error only shows.

        Raises ValueError for a code that 0134h cannot show, a state there is not.
        """
        whole("code", code, 0, 0xFFFF)
        self.al.fail(code, min(AlState(state), self.al.state))
        self._tell_state()

    # ----------------------------------------------------------------- events

    def serve(self, events: int, now: int) -> None:
        """Answer what has happened (bits of `Event`) at `now` (ns)."""
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
        if self.emergencies.pending and self.mailbox.ready:
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
        """What a step upwards needs of the sync managers and of the SYNC unit."""
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
        if self._image.sync_mode == SyncMode.SYNC0 and not self._sync0_on:
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
        """Whether the model can follow the SYNC unit as the master has set it."""
        active = self._pdi.get(SYNC_ACTIVATION, 1) & SYNC_UNIT
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
        return self._pdi.get(SYNC_ACTIVATION, 1) & SYNC_ACTIVE == SYNC_ACTIVE

    def _check_running_clock(self) -> None:
        """Retreat where a master changes the SYNC unit under a drive that runs with it (inferred).

        Without SYNC0 to SAFE_OP (ETG.1020, no sync error); to PRE_OP, where its clock is set, where
        the drive cannot follow.
        """
        if self._image.sync_mode != SyncMode.SYNC0:
            return
        if not self._sync0_on:
            if self.state == AlState.OPERATIONAL:
                self.fail(AlStatusCode.NO_SYNC_ERROR)
        elif code := self._check_clock():
            self.fail(code, AlState.PRE_OPERATIONAL)

    def _entered(self, before: AlState, after: AlState) -> None:
        """Switch on and off what goes with a state."""
        self.drive.operational = after in WITH_INPUTS
        if before == AlState.INIT:
            self._begin_mailbox(after)
        elif after == AlState.INIT:
            self._quiet()
        if before == AlState.PRE_OPERATIONAL and after == AlState.SAFE_OPERATIONAL:
            self._image.sync_mode = SyncMode.SYNC0 if self._sync0_on else SyncMode.SM_EVENT
            own = self.data.error_settings
            limit = self.drive.objects.value(*ERROR_LIMIT) if own else self.data.late_limit
            self._image.late_limit = limit
            self._image.times(self.data.cycle_ns, self.drive.objects.value(*COPY_TIME))
        if (before in WITH_INPUTS) != (after in WITH_INPUTS):
            self._image.inputs(after in WITH_INPUTS)
        if AlState.OPERATIONAL in (before, after):
            self._image.outputs(after == AlState.OPERATIONAL)
            # 6007h is for a drive that loses its master while it moves
            lost = after != AlState.OPERATIONAL and self.drive.energised
            self.drive.axis.connection_lost = lost

    def _begin_mailbox(self, state: AlState) -> None:
        """Mailboxes of INIT to PRE_OP or BOOTSTRAP, where there is only FoE."""
        self._quiet()
        only = (Kind.FOE,) if state == AlState.BOOTSTRAP else tuple(self._offered)
        self.mailbox.services = {
            kind: self._offered[kind] for kind in only if kind in self._offered
        }
        size = self._pdi.sync_manager(IN).length - HEADER.size
        self._sdo.size = self._foe.size = self._eoe.size = size

    def _quiet(self) -> None:
        self.mailbox.reset()
        self._sdo.reset()
        self._foe.reset()
        self.emergencies.reset()
        self._pdi.mailboxes_reset()

    # ------------------------------------------------------- what is kept

    def _keep_alias(self) -> None:
        """A station alias that a master has written lasts, if its checksum holds."""
        alias = sii.alias_of(self._pdi.sii)
        if alias is not None and alias != self.drive.parameters.alias:
            self.drive.parameters.keep_alias(alias)

    def _parameters(self) -> bytes:
        return self.drive.parameters.export()

    def _take_parameters(self, content: bytes) -> str:
        return self.drive.parameters.take(content)

    # ------------------------------------------------------------- snapshot

    def snapshot(self) -> bytes:
        """AL state, telegrams that wait, transfers in progress; `restore` goes on with them."""
        al = self.al
        state: Any = (
            int(al.state), al.error, al._error_code, al._acknowledge, al._identify,
            self.mailbox.state(), tuple(map(int, self.mailbox.services)), self._sdo.state(),
            self._sdo.size, self._foe.state(), self.emergencies.state(), self._identification,
            self.drive.operational,
        )
        return seal(self._kind, {}, [repr(state).encode()])

    @property
    def _kind(self) -> dict[str, Any]:
        return {"kind": "slave", "model": self.drive.model.name}

    def restore(self, snapshot: bytes) -> None:
        """Become what `snapshot` was.

        Raises:
            ValueError: it is none, damaged, or of another model; nothing is changed.
        """
        _, (state,) = unseal(snapshot, self._kind, {}, [None])
        (
            al_state, self.al.error, self.al._error_code, self.al._acknowledge,
            self.al._identify, mailbox, services, sdo, size, foe, emergencies,
            self._identification, self.drive.operational,
        ) = ast.literal_eval(state.decode())
        self.al.state = AlState(al_state)
        self.mailbox.restore(mailbox)
        self.mailbox.services = {Kind(kind): self._offered[Kind(kind)] for kind in services}
        self._sdo.restore(sdo)
        self._sdo.size = self._foe.size = self._eoe.size = size
        self._foe.restore(foe)
        self.emergencies.restore(emergencies)


def _refuse(body: bytes) -> Answer:
    """A protocol that the device names and that leads nowhere here."""
    return MailboxError.SERVICE_NOT_SUPPORTED
