"""The units of the factor group: their size in SI, and exact fractions of revolutions and s.

Factor group as in CiA 402-2 / IEC 61800-7-201: position units = increments * (608Fh) * (6091h) *
(6092h), or in models with `older_factor_group` that of DSP 402 V2 (6093h, 6094h, 6097h). All are
integers, reduced to one exact fraction.
"""

import math

from ..jit import block
from ..record import OBJECTS, Axis, Objects

FACTORS = tuple(row.field for row in OBJECTS if row.how == "factor")  # fields of `od`
FRACTION_LIMIT = 1 << 31  # of both parts of the fraction: keeps every product inside 63 bits
EXACT = 1 << 60  # of both parts of a fraction of revolutions and s


@block
def measure(axis: Axis):
    """Size of the units in SI, signed by the polarity.

    With a factor of 0, or a fraction too long to be exact, the last units hold. Objects refuse
    both, but process data and programs may bring them, and a division by 0 would end the process.
    """
    od = axis.od
    if _zero(od, axis.older_factor_group):
        return
    numerator, denominator = older_fraction(od) if axis.older_factor_group else fraction(od)
    if not (0 < numerator <= FRACTION_LIMIT and 0 < denominator <= FRACTION_LIMIT):
        return
    axis.position_numerator = numerator
    axis.position_denominator = denominator
    resolution = od.position_encoder_resolution[0] / od.position_encoder_resolution[1]
    axis.rad_per_increment = 2 * math.pi / resolution
    unit = axis.rad_per_increment * denominator / numerator
    if axis.older_factor_group:
        per_minute = 2 * math.pi / 60
        speed = od.velocity_encoder_factor[0] / od.velocity_encoder_factor[1] * per_minute / 4096
        acceleration = od.acceleration_factor[0] / od.acceleration_factor[1] * per_minute / 256
    else:
        speed = unit * od.velocity_factor[0] / od.velocity_factor[1]
        acceleration = unit * od.acceleration_factor[0] / od.acceleration_factor[1]
    axis.rad_per_position_unit = -unit if od.polarity & 0x80 else unit
    axis.rad_s_per_velocity_unit = -speed if od.polarity & 0x40 else speed
    axis.rad_s2_per_acceleration_unit = acceleration


@block
def _zero(od: Objects, older):
    """Whether a factor in use is 0, which only process data and programs can bring."""
    a, b, c = od.gear_ratio, od.feed_constant, od.velocity_factor
    if older:
        a, b, c = od.position_factor, od.position_factor, od.velocity_encoder_factor
    d, e = od.acceleration_factor, od.position_encoder_resolution
    return min(a[0], a[1], b[0], b[1], c[0], c[1], d[0], d[1], e[0], e[1]) == 0


@block
def fraction(od: Objects):
    """Position units per increment as a reduced fraction; objects keep it below 2^31."""
    a, b = int(od.position_encoder_resolution[1]), int(od.position_encoder_resolution[0])
    c, d = int(od.gear_ratio[1]), int(od.gear_ratio[0])
    e, f = int(od.feed_constant[0]), int(od.feed_constant[1])
    a, b = reduced(a, b)
    a, d = reduced(a, d)
    a, f = reduced(a, f)
    c, b = reduced(c, b)
    c, d = reduced(c, d)
    c, f = reduced(c, f)
    e, b = reduced(e, b)
    e, d = reduced(e, d)
    e, f = reduced(e, f)
    return a * c * e, b * d * f


@block
def older_fraction(od: Objects):
    """Return the fraction from 6093h, with 65536 increments a revolution (DSP 402 V2)."""
    a, b = 65536 * int(od.position_encoder_resolution[1]), int(od.position_encoder_resolution[0])
    c, d = int(od.position_factor[1]), int(od.position_factor[0])
    a, b = reduced(a, b)
    a, d = reduced(a, d)
    c, b = reduced(c, b)
    c, d = reduced(c, d)
    return a * c, b * d


@block
def reduced(numerator, denominator):
    """Return a fraction in lowest terms."""
    common = math.gcd(numerator, denominator)
    return numerator // common, denominator // common


@block
def product(a, b, c, d):
    """``a / b * c / d`` in lowest terms; (0, 0) where it does not fit."""
    if a == 0 or b == 0:
        return 0, 0
    a, d = reduced(int(a), int(d))
    c, b = reduced(int(c), int(b))
    if max(float(a) * float(c), float(b) * float(d)) >= EXACT:
        return 0, 0
    return a * c, b * d
