"""Touch probe 60B8h-60BDh: positions stored at the edges of two inputs or at the index pulse.

Source: CiA 402-2, touch probe. Function 60B8h, probe 1 in bits 0-5, probe 2 in bits 8-13: enable,
continuous (else first event only), source (00 input, 01 index pulse), -, sample at the positive
edge, sample at the negative edge. Sampled with the encoder, once a velocity cycle; the index pulse
is exact to the increment. Status 60B9h: enabled, positive stored, negative stored.
"""

from .jit import block
from .record import Axis


@block
def read(axis: Axis):
    """The two inputs as bits; `AXIS.probe_inputs` holds those of the previous velocity cycle."""
    return int(axis.touch_probe[0]) | int(axis.touch_probe[1]) << 1


@block
def sample(axis: Axis, now, index_counts, index_passed):
    """Latch encoder counts at the awaited edges of this velocity cycle."""
    changed = now ^ axis.probe_inputs
    function = command(axis)
    for probe in range(2):
        bits = function >> 8 * probe
        if not bits & 1:
            continue
        rising = changed >> probe & 1 and now >> probe & 1
        falling = changed >> probe & 1 and not now >> probe & 1
        counts = axis.counts
        if bits >> 2 & 3 == 1:
            rising, falling, counts = index_passed, False, index_counts
        continuous = bits & 2 and not axis.od.sample_mode
        if rising and bits & 0x10:
            _store(axis, 2 * probe, counts, continuous)
        if falling and bits & 0x20:
            _store(axis, 2 * probe + 1, counts, continuous)


@block
def command(axis: Axis):
    """Function word of both probes: 60B8h, or the equivalent of a model's own control word."""
    if not axis.latch_words:
        return int(axis.od.touch_probe_function)
    control = int(axis.od.latch_control)
    first, second = control & 3, control >> 2 & 3  # positive, negative edge
    return (1 | first << 4 if first else 0) | ((1 | second << 4) << 8 if second else 0)


@block
def _latch_words(axis: Axis):
    """Set the latch status, and the positions selected by the control word.

    Source: Kollmorgen AKD 5.12. Bits 0-3 stored edges, bits 8-11 the edge whose position is shown,
    bits 12-15 inputs 4 to 1. Without a request latch 1 is shown (inferred).
    """
    od = axis.od
    asked = int(od.latch_control) >> 8 & 0x1F
    edge = asked - 1 if 1 <= asked <= 4 else 0
    even = edge & ~1
    od.latch_position[0] = od.touch_probe_position[even]
    od.latch_position[1] = od.touch_probe_position[even + 1]
    for probe in range(2):  # 20A6h, 20A7h: the edge that came last
        newest = 2 * probe + int(axis.probe_newest[probe])
        od.latch_position[2 + probe] = od.touch_probe_position[newest]
    acknowledged = asked if 1 <= asked <= 4 and axis.probe_stored >> edge & 1 else 0
    inputs = int(axis.touch_probe[0]) << 15 | int(axis.touch_probe[1]) << 14
    od.latch_status = (axis.probe_stored & 0xF) | acknowledged << 8 | inputs


@block
def _store(axis: Axis, place, counts, continuous):
    stored = axis.probe_stored >> place & 1
    if stored and not continuous:
        return
    axis.probe_stored |= 1 << place
    axis.probe_counts[place] = counts
    axis.probe_newest[place >> 1] = place & 1
    axis.od.touch_probe_counter[place] = (int(axis.od.touch_probe_counter[place]) + 1) & 0xFFFF


@block
def publish(axis: Axis):
    """Set the status word of the two probes; clearing the enable bit clears the stored edges."""
    function = command(axis)
    status = 0
    for probe in range(2):
        if function >> 8 * probe & 1:
            status |= (1 | (axis.probe_stored >> 2 * probe & 3) << 1) << 8 * probe
        else:
            axis.probe_stored &= ~(3 << 2 * probe)
    axis.od.touch_probe_status = status
    _sampling(axis)
    if axis.latch_words:
        _latch_words(axis)


@block
def _sampling(axis: Axis):
    """Sample the edges of probe 1 as in Festo CMMP-AS 5.15: bit 0 falling, bit 1 rising."""
    od = axis.od
    clear = int(od.sample_control)
    od.sample_control = 0
    axis.probe_stored &= ~((clear >> 1 & 1) | (clear & 1) << 1)
    stored = axis.probe_stored
    od.sample_status = (stored & 1) << 1 | (stored >> 1 & 1)
