"""Outputs and inputs of a drive: sync managers 2 and 3 <-> its PDOs, by address, compiled.

The bytes pass through `process_data.latch` and `collect`, like those of CAN and the environments.
Outputs reach the drive once the last byte of sync manager 2 has been written, or at SYNC0
(ETG.1020, synchronization); an incomplete buffer does not reach it.
"""

from ...kernel.jit import block, entry
from ...kernel.process_data import PDO, collect, latch
from ...kernel.record import AXIS
from ...memory import address, bytes_at, viewer
from .record import NEVER, Event
from .registers import R

AXIS_SIZE = AXIS.itemsize
OUTPUTS, INPUTS = 2, 3  # sync managers
NONE_WRITTEN = 0x30  # buffer status of a sync manager: no buffer has been written

axes_at = viewer(AXIS)
pdos_at = viewer(PDO)


@block
def take_outputs(esc):
    """Give the last complete buffer of SM2 to the drive if it accepts outputs."""
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
    """Put the drive's TPDOs into the free buffer of SM3; report a fault that came or went."""
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
    """Publish the inputs of all drives of a segment; -> their events."""
    events = 0
    for i in range(len(escs)):
        give_inputs(escs[i])
        events |= escs[i].events
    return events


class ProcessImage:
    """The process image of one slave, which its services switch on and off.

    Args:
        escs: the ESC records of the segment.
        index: the slave's record.
        drive: the owner of the PDOs; None for a slave without a drive.
    """

    def __init__(self, escs, index, drive):
        self._escs = escs[index : index + 1]
        self.esc = escs[index]  # a view: its fields may be read and set
        self._drive = drive
        self.prepare()

    def prepare(self) -> None:
        """Note addresses and lengths of the PDOs; to be called after each change of the mapping."""
        if self._drive is None:
            return
        esc, drive = self.esc, self._drive
        esc.axis = address(drive.axes) + drive.index * AXIS_SIZE
        esc.rpdos, esc.rpdo_count = address(drive.rpdos), len(drive.rpdos)
        esc.tpdos, esc.tpdo_count = address(drive.tpdos), len(drive.tpdos)
        esc.rpdo_size, esc.tpdo_size = drive.rpdo_size, drive.tpdo_size

    def inputs(self, on: bool) -> None:
        """Publish inputs from now on, or no longer; reading them then does not count."""
        self.esc.inputs_on = on
        self.esc.memory[R.SYNC_MANAGER + 8 * INPUTS + 5] |= NONE_WRITTEN
        self.esc.sm_fresh[INPUTS] = 0
        if on:
            self.prepare()
            publish(self._escs)

    def outputs(self, on: bool) -> None:
        """Accept outputs from now on, or no longer; the next ones start the watchdog."""
        self.esc.outputs_on = on
        self.esc.outputs_late = 0
        self.esc.outputs_at = -NEVER // 2
        if not on:
            self.esc.watchdog_at = NEVER
