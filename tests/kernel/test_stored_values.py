"""Stored values keep their physical meaning when a factor or the polarity changes.

Metronix ARS 2000 6.3.1: parameters are stored in internal units and converted when they are read
and written; 6.3.2.5: the polarity does not change what is stored. Festo CMMP-AS 5.3 likewise. The
oracle is exact arithmetic with fractions on the factors of the test. Models whose manual says
nothing keep the numbers.
"""

import math
from contextlib import suppress
from fractions import Fraction

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from conftest import Shaft
from servogym.drive.drive import Drive
from servogym.drive.kernel.factors.stored import OFF
from servogym.drive.kernel.record import AXIS, OBJECTS, OWN, OWN_STORED, PLACES, Kind
from servogym.drive.model.model import load, model_names
from servogym.drive.objects.abort import SdoAbort
from servogym.drive.objects.kept import FIELD_PLACES, place

PUBLISHED = (  # written each cycle, not stored
    "position_demand_value", "position_actual_value", "velocity_demand_value",
    "velocity_actual_value", "touch_probe_position", "following_error_actual_value",
    "control_effort", "velocity_actual_value_filtered", "latch_position",
)


@pytest.fixture(scope="module")
def keeping_generic(tmp_path_factory):
    """The newer factor group, 608Fh, 6091h, 6092h, 6096h and 6097h, with values that keep."""
    folder = tmp_path_factory.mktemp("keeping")
    (folder / "drive.toml").write_text(
        'based_on = "generic"\n[quirks]\nvalues_keep_meaning = { value = 1, source = "a test" }\n'
    )
    return folder


KEEPING = [m for m in model_names() if load(m).quirk("values_keep_meaning")]
OTHERS = [m for m in model_names() if not load(m).quirk("values_keep_meaning")]


def test_the_models_whose_manuals_say_so_keep_values():
    family = {m for m in model_names() if load(m).quirk("older_factor_group")}
    assert set(KEEPING) == family


@pytest.fixture(params=[*KEEPING, "keeping_generic"])
def drive(request):
    name = request.param
    return Drive(request.getfixturevalue(name) if name == "keeping_generic" else name)


def units(drive):
    """Size of a unit by kind (revolutions, per s, per s²), from the objects alone."""
    od = drive.axis.od
    ratio = {f: Fraction(*(int(v) for v in od[f])) for f in FACTOR_FIELDS[bool(older(drive))]}
    if older(drive):
        position = ratio["position_factor"] / 65536
        speed = ratio["velocity_encoder_factor"] / (4096 * 60)
        acceleration = ratio["acceleration_factor"] / (256 * 60)
    else:
        position = ratio["gear_ratio"] / ratio["feed_constant"]
        speed = position * ratio["velocity_factor"]
        acceleration = position * ratio["acceleration_factor"]
    polarity = int(od.polarity)
    return {
        Kind.POSITION: -position if polarity & 0x80 else position,
        Kind.VELOCITY: -speed if polarity & 0x40 else speed,
        Kind.WIDTH: position,
        Kind.SPEED: speed,
        Kind.ACCELERATION: acceleration,
    }


def older(drive):
    return drive.model.quirk("older_factor_group")


FACTOR_FIELDS = {
    True: ("position_factor", "velocity_encoder_factor", "acceleration_factor"),
    False: ("gear_ratio", "feed_constant", "velocity_factor", "acceleration_factor"),
}
INDEX = {
    "position_factor": 0x6093, "velocity_encoder_factor": 0x6094, "acceleration_factor": 0x6097,
    "gear_ratio": 0x6091, "feed_constant": 0x6092, "velocity_factor": 0x6096,
}


def kind(slot):
    """Kind of an object's unit, from the words of its row and what kind of number it is."""
    first = slot.row.unit.split()[0] if slot.row.unit else "position"  # 607Dh of one manual
    signed = slot.row.format.islower()
    magnitude = slot.row.name in ("max_slippage",) or slot.row.index in (0x2416,)
    if first == "position":
        return Kind.POSITION if signed else Kind.WIDTH
    if first in ("speed", "velocity"):
        return Kind.VELOCITY if signed and not magnitude else Kind.SPEED
    return Kind.ACCELERATION


UNITS = ("position", "speed", "velocity", "acceleration", "jerk")


def stored_objects(drive):
    """Everything a master may write in position, velocity or acceleration units."""
    found = []
    for slot in drive.objects.slots.values():
        row = slot.row
        words = row.unit.split()
        in_units = len(words) == 2 and words[0] in UNITS and words[1] in ("unit", "units")
        in_units = in_units or row.name in ("min_position_limit", "max_position_limit")
        if in_units and row.access in ("rw", "wo") and row.index != 0x6092:
            found.append(slot)
    return found


def shown(number, was, now, slot):
    """The number of a value in other units, saturated: what a master reads."""
    exact = Fraction(number) * was / now
    low, high = (-(2 ** (8 * slot.row.size - 1)), 2 ** (8 * slot.row.size - 1) - 1)
    if not slot.row.format.islower():
        low, high = 0, 2 ** (8 * slot.row.size) - 1
    if slot.row.index in (0x6065, 0x6067):
        high = OFF - 1
    return min(max(math.floor(exact + Fraction(1, 2)), low), high)


def write_factor(drive, field, numerator, divisor):
    """Both parts; -> whether the drive took them."""
    try:
        drive.write(INDEX[field], 2, divisor)
        drive.write(INDEX[field], 1, numerator)
    except SdoAbort:
        return False
    return True


def test_every_field_in_units_of_the_factor_group_is_kept_or_published():
    units = {f"{of} unit" for of in UNITS}
    names = {row.field for row in OBJECTS if row.unit in units}
    assert set(PLACES) == names - set(PUBLISHED)
    places = sorted(FIELD_PLACES.values())
    assert places == [*range(OWN)], "without gaps and overlaps"
    assert AXIS["kept_raw"].shape == (OWN + OWN_STORED,), "no value is kept behind the array"


@pytest.mark.parametrize("name", KEEPING)
def test_ramps_by_direction_and_the_limit_of_speed_are_kept_too(name):
    model = load(name)
    places = [place(model, model.objects[0x2090, n]) for n in range(2, 6)]
    assert places == [PLACES["velocity_ramps"] + n for n in range(4)]
    assert place(model, model.objects[0x2416, 2]) == PLACES["limit_speed"]


part = st.one_of(st.integers(1, 60), st.integers(1, 100_000), st.integers(1, 2**24))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40)
@given(data=st.data())
def test_a_value_reads_the_same_in_any_units_and_returns_as_it_was_written(drive, data):
    drive.reset()
    drive.parameters.forget()
    slots = stored_objects(drive)
    assert len(slots) > 20
    slot = data.draw(st.sampled_from(slots))
    low = max(slot.row.minimum, -(2**31)) if slot.row.format.islower() else slot.row.minimum
    number = data.draw(st.integers(int(low), int(slot.row.maximum)))
    with suppress(SdoAbort):  # a locked object
        drive.write(slot.row.index, slot.row.subindex, number)
        assert slot.get() == number
    numbers = {s: s.get() for s in slots}
    first = units(drive)
    before = {field: drive.axis.od[field].tolist() for field in FACTOR_FIELDS[bool(older(drive))]}
    for _ in range(data.draw(st.integers(1, 4))):
        field = data.draw(st.sampled_from(FACTOR_FIELDS[bool(older(drive))]))
        write_factor(drive, field, data.draw(part), data.draw(part))
        if data.draw(st.booleans()):
            drive.write("polarity", data.draw(st.sampled_from((0x00, 0x40, 0x80, 0xC0))))
        now = units(drive)
        for s, was in numbers.items():
            if s.row.index in (0x6065, 0x6067) and was == OFF:
                assert s.get() == OFF
                continue
            expected = shown(was, first[kind(s)], now[kind(s)], s)
            assert s.get() == expected, (s.row.name, was, first[kind(s)], now[kind(s)])
    drive.write("polarity", 0)
    waiting = [*before]
    while waiting:  # one may be refused beside extremes of another that has its turn later
        refused = [field for field in waiting if not write_factor(drive, field, 1, 1)]
        assert len(refused) < len(waiting)
        waiting = refused
    for field, (numerator, divisor) in before.items():
        assert write_factor(drive, field, numerator, divisor)
    assert {s: s.get() for s in slots} == numbers


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150)
@given(st.integers(0, 5_000), st.integers(1, 5_000), st.integers(0, 5_000))
def test_what_lies_halfway_is_rounded_upwards_exactly(drive, p, q, odd):
    """The ratio p / 2q of the units is not a binary fraction: floating point misses the middle."""
    p, number = 2 * p + 1, q * (2 * odd + 1)
    field = "velocity_encoder_factor" if older(drive) else "velocity_factor"
    assert write_factor(drive, field, p, 1)
    drive.write("profile_velocity", number)
    assert write_factor(drive, field, 2 * q, 1)
    assert drive.read("profile_velocity") == min((p * (2 * odd + 1) + 1) // 2, 2**32 - 1)


PARAMETERS = (  # what the cycle works with
    "target_position", "target_velocity", "position_offset", "velocity_offset", "home_offset",
    "ip_data", "position_limit_min", "position_limit_max", "range_min", "range",
    "max_profile_speed", "profile_speed", "end_speed", "acceleration", "deceleration",
    "quick_stop_deceleration", "jerk", "homing_speed_switch", "homing_speed_zero",
    "homing_acceleration", "max_slippage", "following_error_window", "position_window",
    "velocity_window", "velocity_threshold", "position_error_limit", "correction_limit",
    "dead_band", "limit_deceleration",
)


def physics(drive):
    drive.cycle(0.0)
    return {name: drive.axis[name].tolist() for name in PARAMETERS}


@pytest.mark.parametrize("polarity", [0x00, 0x40, 0x80, 0xC0])
@pytest.mark.parametrize(("numerator", "divisor"), [(1, 1000), (7, 3), (60, 1), (1 << 20, 1)])
def test_what_the_cycle_works_with_does_not_move(drive, numerator, divisor, polarity):
    drive.write("target_position", 12_345)
    drive.write("home_offset", -77)
    drive.write("min_position_limit", -500_000)
    drive.write("max_position_limit", 700_000)
    before = physics(drive)
    for field in FACTOR_FIELDS[bool(older(drive))]:
        assert write_factor(drive, field, numerator, divisor)
    drive.write("polarity", polarity)
    assert physics(drive) == before, "bit by bit"


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_value_written_after_the_change_is_a_number_in_the_new_units(drive, when):
    speed = "profile_velocity"
    if when == "before":
        drive.write(speed, 300)
        drive.cycle(0.0)
    field = "velocity_encoder_factor" if older(drive) else "velocity_factor"
    before = units(drive)[Kind.SPEED]
    numerator, divisor = (int(v) for v in drive.axis.od[field])
    assert write_factor(drive, field, numerator, divisor * 7)
    if when == "after":
        drive.write(speed, 300)
        drive.cycle(0.0)
        expected = 300 * before / 7
    else:
        assert drive.read(speed) == 2100
        expected = 300 * before
    drive.cycle(0.0)
    assert drive.axis.profile_speed == pytest.approx(float(expected) * 2 * math.pi, rel=1e-12)


def test_writing_the_number_that_is_shown_makes_it_the_value(drive):
    field = "velocity_encoder_factor" if older(drive) else "velocity_factor"
    numerator, divisor = (int(v) for v in drive.axis.od[field])
    drive.write("profile_velocity", 1001)
    assert write_factor(drive, field, numerator * 10, divisor)
    assert drive.read("profile_velocity") == 100
    drive.write("profile_velocity", 100)
    assert write_factor(drive, field, numerator, divisor)
    assert drive.read("profile_velocity") == 1000


@pytest.mark.parametrize("path", ["stored", "kept"])
def test_a_power_off_in_coarse_units_loses_nothing(drive, path):
    field = "velocity_encoder_factor" if older(drive) else "velocity_factor"
    numerator, divisor = (int(v) for v in drive.axis.od[field])
    drive.write("profile_velocity", 1234)
    assert write_factor(drive, field, numerator * 1000, divisor)
    assert drive.read("profile_velocity") == 1
    before = physics(drive)
    assert drive.parameters.save()
    for _ in range(2):
        drive.reset(keep_parameters=path == "kept")
        after = physics(drive)
        assert after["profile_speed"] == before["profile_speed"]
        assert after["homing_speed_switch"] == before["homing_speed_switch"]
    assert write_factor(drive, field, numerator, divisor)
    assert drive.read("profile_velocity") == 1234
    drive.reset()
    drive.parameters.forget()
    drive.reset()
    assert drive.axis.converted == 0


@pytest.mark.parametrize("name", KEEPING)
def test_defaults_of_objects_that_are_not_stored_keep_their_meaning_over_a_power_off(name):
    drive = Drive(name)
    before = physics(drive)
    assert write_factor(drive, "acceleration_factor", 15360, 60_000)
    assert drive.parameters.save()
    drive.reset()
    after = physics(drive)
    for parameter in ("acceleration", "quick_stop_deceleration", "limit_deceleration"):
        assert after[parameter] == before[parameter], parameter


@pytest.mark.parametrize("name", KEEPING)
def test_loading_the_defaults_brings_the_default_values_in_the_default_units(name):
    fresh, drive = physics(Drive(name)), Drive(name)
    assert write_factor(drive, "velocity_encoder_factor", 4096, 60_000)
    drive.write("profile_velocity", 5)
    drive.write(0x1011, 1, 0x64616F6C)
    assert drive.read("profile_velocity") == load(name).names["profile_velocity"].default
    assert physics(drive)["profile_speed"] == fresh["profile_speed"]


@pytest.mark.parametrize("name", KEEPING)
def test_a_factor_that_comes_by_pdo_converts_as_well(name):
    shaft = Shaft(name)
    shaft.step(2)
    shaft.axis.od.velocity_encoder_factor[1] = 1000
    shaft.axis.parameters_changed = 1
    speed = float(shaft.axis.profile_speed)
    shaft.step()
    assert shaft.axis.profile_speed == speed
    assert shaft.read("profile_velocity") == 1000 * 1000


@pytest.mark.parametrize("field", ["position_factor", "acceleration_factor", "polarity"])
@pytest.mark.parametrize("name", KEEPING)
def test_a_factor_of_0_by_pdo_leaves_the_units_as_they_were(name, field):
    shaft = Shaft(name)
    shaft.step(2)
    before = physics(shaft.drive)
    number = shaft.read("profile_acceleration")
    shaft.axis.od[field] = 0
    shaft.axis.parameters_changed = 1
    assert physics(shaft.drive) == before
    assert shaft.read("profile_acceleration") == number


@pytest.mark.parametrize("name", KEEPING)
def test_the_polarity_does_not_switch_a_limit_off_or_a_range(name):
    shaft = Shaft(name)
    shaft.write(min_position_limit=-1000, max_position_limit=3000)
    shaft.write(polarity=0xC0)
    shaft.step()
    limits = shaft.read("min_position_limit"), shaft.read("max_position_limit")
    assert limits == (1000, -3000), "each has its value"
    unit = 2 * math.pi / 65536
    assert shaft.axis.position_limit_min == pytest.approx(-1000 * unit)
    assert shaft.axis.position_limit_max == pytest.approx(3000 * unit)


@pytest.mark.parametrize("name", OTHERS)
def test_other_models_keep_the_numbers(name):
    drive = Drive(name)
    fields = [f for f in FACTOR_FIELDS[False] if (INDEX[f], 1) in drive.objects.slots]
    numbers = {s: s.get() for s in stored_objects(drive)}
    for field in fields:
        assert write_factor(drive, field, 3, 7)
    if "polarity" in drive.objects.names:
        drive.write("polarity", 0xC0)
    drive.cycle(0.0)
    assert {s: s.get() for s in numbers} == numbers


def test_homing_does_not_crawl_after_the_velocity_unit_has_become_1_µm_per_s():
    """6094h in µm/s: 6099h:01 reads the old speed, homing does not crawl."""
    shaft = Shaft("festo_cmmp_as")
    shaft.step()
    assert shaft.read("speed_during_search_for_switch") == 100, "1/min"
    shaft.drive.write(0x6094, 2, 60_000)  # µm/s at 60 mm a turn
    shaft.drive.write(0x6094, 1, 60 * 4096)
    shaft.step()
    assert shaft.read("speed_during_search_for_switch") == 100 * 60_000 // 60
    assert shaft.axis.homing_speed_switch == pytest.approx(100 / 60 * 2 * math.pi)
