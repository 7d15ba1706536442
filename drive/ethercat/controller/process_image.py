"""Outputs and inputs of a drive: sync managers 2 and 3 <-> its PDOs, by address, compiled.

The bytes go through `process_data.latch` and `collect`, as those of CAN and of the environments do.
Outputs reach the drive when the last byte of sync manager 2 was written, or at SYNC0 (ETG.1020,
synchronization); what a master leaves unfinished does not.
"""

from ...kernel.jit import block, entry
from ...kernel.process_data import PDO, collect, latch
from ...kernel.record import AXIS
from ...memory import address, bytes_at, viewer
from .record import NEVER, Event, SyncMode
from .registers import R

AXIS_SIZE = AXIS.itemsize
OUTPUTS, INPUTS = 2, 3  # sync managers
NONE_WRITTEN = 0x30  # buffer status of a sync manager: no buffer has been written

axes_at = viewer(AXIS)
pdos_at = viewer(PDO)


@block
def take_outputs(esc):
    """Give the last whole buffer of SM2 to the drive, where it takes outputs."""
    esc.sm_fresh[OUTPUTS] = 0
    esc.memory[R.AL_EVENT + 1] &= 0xFF ^ (1 << OUTPUTS)
    if esc.outputs_on == 0 or esc.axis == 0 or esc.sm_length[OUTPUTS] != esc.rpdo_size:
        return
    latch(
        bytes_at(esc.axis, AXIS_SIZE), axes_at(esc.axis, 1)[0], pdos_at(esc.rpdos, esc.rpdo_count),
        esc.local, esc.sm_start[OUTPUTS],
    )


@block
def give_inputs(esc):
    """Put the drive's TPDOs into the free buffer of SM3; tell a fault that came or went."""
    if esc.axis == 0:
        return
    axis = axes_at(esc.axis, 1)[0]
    fault = axis.fault + (axis.faults_present << 8)
    if fault != esc.seen_fault:
        esc.seen_fault = fault
        esc.events |= Event.FAULT
    if esc.inputs_on == 0 or esc.sm_length[INPUTS] != esc.tpdo_size:
        return
    collect(
        bytes_at(esc.axis, AXIS_SIZE), pdos_at(esc.tpdos, esc.tpdo_count), esc.local,
        esc.sm_start[INPUTS],
    )
    esc.sm_fresh[INPUTS] = 1
    status = R.SYNC_MANAGER + 8 * INPUTS + 5
    esc.memory[status] &= 0xFF ^ NONE_WRITTEN


@entry
def publish(escs):
    """Inputs of all drives of a segment; -> their events."""
    events = 0
    for i in range(len(escs)):
        give_inputs(escs[i])
        events |= escs[i].events
    return events


class ProcessImage:
    """The process image of one slave, as its services switch it.

    Args:
        escs: the ESC records of the segment.
        index: which of them.
        drive: whose PDOs these are; None where there is none.
    """

    def __init__(self, escs, index, drive):
        self._escs = escs[index : index + 1]
        self._esc = escs[index]
        self._drive = drive
        self.prepare()

    def prepare(self) -> None:
        """Take over where the PDOs lie and how long they are; after each change of the mapping."""
        if self._drive is None:
            return
        esc, drive = self._esc, self._drive
        esc.axis = address(drive.axes) + drive.index * AXIS_SIZE
        esc.rpdos, esc.rpdo_count = address(drive.rpdos), len(drive.rpdos)
        esc.tpdos, esc.tpdo_count = address(drive.tpdos), len(drive.tpdos)
        esc.rpdo_size, esc.tpdo_size = drive.rpdo_size, drive.tpdo_size

    def inputs(self, on: bool) -> None:
        """Publish inputs from now on, or no longer: then reading them counts nothing."""
        self._esc.inputs_on = on
        self._esc.memory[R.SYNC_MANAGER + 8 * INPUTS + 5] |= NONE_WRITTEN
        self._esc.sm_fresh[INPUTS] = 0
        if on:
            self.prepare()
            publish(self._escs)

    def outputs(self, on: bool) -> None:
        """Take outputs over from now on, or no longer; the watchdog runs with the next ones."""
        self._esc.outputs_on = on
        self._esc.outputs_late = 0
        self._esc.outputs_at = -NEVER // 2
        if not on:
            self._esc.watchdog_at = NEVER

    @property
    def sync_mode(self) -> SyncMode:
        """When outputs are taken over."""
        return SyncMode(int(self._esc.sync_mode))

    @sync_mode.setter
    def sync_mode(self, mode: SyncMode) -> None:
        self._esc.sync_mode = mode

    @property
    def late_limit(self) -> int:
        """SYNC0 edges in a row without new outputs that are borne; 0 = any number."""
        return int(self._esc.late_limit)

    @late_limit.setter
    def late_limit(self, edges: int) -> None:
        self._esc.late_limit = edges

    def times(self, cycle_ns: int, copy_ns: int) -> None:
        """1C32h:05 and 1C32h:06, against which outputs are counted that come too early or late."""
        self._esc.cycle_ns, self._esc.copy_ns = cycle_ns, copy_ns

    @property
    def late(self) -> bool:
        """Whether the last edge of SYNC0 had no new outputs."""
        return bool(self._esc.outputs_late)

    @property
    def sync_errors(self) -> int:
        """1C32h:0B, SYNC0 edges without new outputs."""
        return int(self._esc.sync_errors)

    @property
    def cycle_exceeded(self) -> int:
        """1C32h:0C, outputs that came within the shortest cycle after those before."""
        return int(self._esc.cycle_exceeded)

    @property
    def shift_short(self) -> int:
        """1C32h:0D, SYNC0 edges that came before outputs were copied."""
        return int(self._esc.shift_short)
