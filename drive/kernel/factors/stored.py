"""Stored values that keep their meaning when a factor or the polarity changes.

In models with `values_keep_meaning` an object stores a value and not its number: after the change
it shows the same value in the new units (Metronix ARS 2000 6.3.1, 6.3.2.5; Festo CMMP-AS 5.3). The
record keeps each value as it was written, with the unit of that time, so that rounding affects only
the displayed number.
"""

import math

from ..jit import block
from ..record import KINDS, OWN, OWN_STORED, Axis
from .units import EXACT

OFF = 0xFFFFFFFF  # a window of this size is switched off
WRITTEN = -(1 << 62)  # in `kept_shown`: no number equals it
FARTHEST = 2.0**33  # beyond what any object shows


@block
def show_own(axis: Axis, new):
    """Show kept values of objects in the model's own bytes."""
    for j in range(OWN_STORED):
        size = abs(int(axis.own_size[j]))
        if not 0 < size <= 8 or axis.own_kind[j] >= KINDS:
            return
        if axis.own_place[j] > len(axis.od.vendor) - size:
            return
        at, sign, number = int(axis.own_place[j]), 1 << (8 * size - 1), 0
        for k in range(size):
            number |= int(axis.od.vendor[at + k]) << 8 * k
        high = 2 * sign - 1
        low = 0
        if axis.own_size[j] < 0:
            number = (number ^ sign) - sign
            low, high = -sign, sign - 1
        number = shown(axis, OWN + j, number, int(axis.own_kind[j]), new, low, high)
        for k in range(size):
            axis.od.vendor[at + k] = number >> 8 * k & 0xFF


@block
def shown(axis: Axis, n, number, kind, new, low, high):
    """The number of stored value `n` in new units; the value as written is kept."""
    if number > high:
        axis.kept_shown[n] = WRITTEN
        return number  # a window that is switched off
    if not axis.converted or axis.kept_shown[n] != number:
        axis.kept_raw[n] = number
        axis.kept_unit[n] = axis.unit[kind]
        axis.kept_numerator[n] = axis.unit_numerator[kind]
        axis.kept_denominator[n] = axis.unit_denominator[kind]
    units, numerators, denominators = new
    shown = _rounded(
        int(axis.kept_raw[n]), axis.kept_unit[n] / units[kind],
        int(axis.kept_numerator[n]), int(axis.kept_denominator[n]),
        int(numerators[kind]), int(denominators[kind]),
    )
    shown = min(max(shown, low), high)
    axis.kept_shown[n] = shown
    return shown


@block
def _rounded(number, ratio, a, b, c, d):
    """`number` * `ratio` to the nearest, halves upwards; the ratio is ``a / b / (c / d)``."""
    about = min(max(number * ratio, -FARTHEST), FARTHEST)
    shown = int(math.floor(about + 0.5))
    p, q = a * d, b * c  # only q has to fit, see below
    if abs(about) == FARTHEST or q == 0 or abs(float(b) * float(c)) >= EXACT:
        return shown
    if q < 0:
        p, q = -p, -q
    beyond = 2 * number * p - (2 * shown - 1) * q  # a small number: overflows cancel
    if beyond < 0:
        return shown - 1
    return shown + 1 if beyond >= 2 * q else shown


@block
def value(axis: Axis, n, number, unit):
    """Stored value `n` (SI): as it was written, or the number that was written since."""
    if axis.converted and axis.kept_shown[n] == number:
        return axis.kept_raw[n] * axis.kept_unit[n]
    return number * unit


@block
def ordered(axis: Axis, n, low, high):
    """Whether the first of a pair of stored values is the lower one, as they were written."""
    if axis.converted and axis.kept_shown[n] == low and axis.kept_shown[n + 1] == high:
        first = axis.kept_raw[n] * abs(axis.kept_unit[n])
        return first < axis.kept_raw[n + 1] * abs(axis.kept_unit[n + 1])
    return low < high
