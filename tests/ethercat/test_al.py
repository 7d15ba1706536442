"""AL state machine through the slave controller: ETG.1000.6, 6.4.1; ETG.1020."""

import struct

import pytest
from wired import PATH, B, I, O, P, S, Wired

from servogym.drive.ethercat.al import AlState, AlStatusCode
from servogym.drive.kernel.words import State

MODELS = ("generic", "festo_cmmp_as", "kollmorgen_akd")
# ETG.1000.6, table 9: what may be requested where; everything else is 0011h, an unknown state 0012h
ALLOWED = {I: {I, P, B}, P: {P, I, S}, B: {B, I}, S: {S, I, P, O}, O: {O, I, P, S}}
KNOWN = {1, 2, 3, 4, 8}


def wired(model):
    if model == "festo_cmmp_as":  # none of its PDOs is assigned by default
        slave = Wired(model).to(P)
        slave.assign([0x1600], [0x1A00])
        slave.request(I)
        return slave
    return Wired(model)


@pytest.fixture(scope="module", params=MODELS)
def slave(request):
    return wired(request.param)


def outcome(slave, source, target):
    """State and code of the table of a model."""
    if target not in KNOWN:
        return source | 0x10, 0x0012
    if target == B and not slave.data.al.bootstrap and source != B:
        return source | 0x10, 0x0013
    if target not in ALLOWED[source]:
        return source | 0x10, 0x0011
    return target, 0


@pytest.mark.parametrize("source", AlState)
def test_15_every_state_request_has_the_state_and_code_of_the_table(slave, source):
    if source == B and not slave.data.al.bootstrap:
        pytest.skip("the model has no bootstrap")
    for target in range(16):
        slave.request(I, 0x10)
        slave.request(I)
        slave.to(*PATH[source])
        slave.configure(boot=target == B)
        assert slave.request(target) == outcome(slave, source, target), target


@pytest.mark.parametrize("source", [P, S, O])
def test_16_an_error_stays_until_it_is_acknowledged(slave, source):
    slave.request(I, 0x10)
    slave.request(I)
    slave.to(*PATH[source])
    assert slave.request(0x0F) == (source | 0x10, 0x0012)
    assert slave.request(source) == (source | 0x10, 0x0012), "not without bit 4"
    assert slave.request(P) == (source | 0x10, 0x0012), "nor by another request"
    assert slave.request(source, 0x10) == (source, 0)
    assert slave.request(0x0F) == (source | 0x10, 0x0012)
    assert slave.request(P, 0x10) == (P, 0), "acknowledged and left in one"


def test_init_acknowledges_without_bit_4_as_the_model_says(slave):
    slave.request(I, 0x10)
    slave.request(I)
    slave.to(P)
    slave.request(0x0F)
    acknowledges = slave.data.al.init_acknowledges
    assert slave.request(I) == ((I, 0) if acknowledges else (P | 0x10, 0x0012))


def test_16_akd_acknowledges_by_the_rising_edge_of_bit_4():
    slave = Wired("kollmorgen_akd").to(P)
    slave.request(P, 0x10)
    assert slave.request(0x0F, 0x10) == (P | 0x10, 0x0012)
    assert slave.request(P, 0x10) == (P | 0x10, 0x0012), "bit 4 has not been 0 (5.3.1)"
    slave.request(P)
    assert slave.request(P, 0x10) == (P, 0)


def test_16_the_level_of_bit_4_acknowledges_elsewhere():
    slave = Wired("generic").to(P)
    slave.request(P, 0x10)
    assert slave.request(0x0F, 0x10) == (P | 0x10, 0x0012)
    assert slave.request(P, 0x10) == (P, 0)


# model -> code for a wrong SM0 or SM1; ETG.1020: 0016h, Kollmorgen AKD 5.3.3: 0017h
MAILBOX = {"generic": 0x0016, "festo_cmmp_as": 0x0016, "kollmorgen_akd": 0x0017}


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("change", [(2, 0, 0), (0, 1, 0), (0, 0, -1)])
def test_17_a_wrong_mailbox_is_refused_with_the_code_of_the_model(slave, number, change):
    slave.request(I, 0x10)
    slave.request(I)
    slave.configure()
    at, length = slave.data.mailbox[2 * number : 2 * number + 2]
    moved, longer, enable = change
    control = slave.data.mailbox_control[number]
    slave.sync_manager(number, at + moved, length + longer, control, 1 + enable)
    wanted = MAILBOX[slave.drive.model.name]
    assert slave.request(P) == (I | 0x10, wanted)
    slave.request(I, 0x10)
    slave.to(P)


@pytest.mark.parametrize(("number", "code"), [(2, 0x001D), (3, 0x001E)])
@pytest.mark.parametrize("change", [(2, 0), (0, 1), (0, -1)])
def test_17_wrong_process_data_are_refused(slave, number, code, change):
    slave.request(I, 0x10)
    slave.request(I)
    slave.to(P)
    slave.configure()
    size = (slave.drive.rpdo_size, slave.drive.tpdo_size)[number - 2]
    start, control = slave.data.start[number - 2], slave.data.control[number - 2]
    slave.sync_manager(number, start + change[0], size + change[1], control)
    assert slave.request(S) == (P | 0x10, code)
    slave.request(P, 0x10)
    slave.to(S)


def test_akd_refuses_17_bytes_on_both_sync_managers_as_a_real_one_did():
    slave = Wired("kollmorgen_akd").to(P)
    for n in (2, 3):
        slave.sync_manager(n, slave.data.start[n - 2], 17, slave.data.control[n - 2])
    assert slave.request(S) == (P | 0x10, 0x001D)


def test_17_a_shorter_mailbox_is_taken_where_the_model_allows_it():
    Wired("generic", mailbox=(64, 64)).to(P)
    slave = Wired("generic", mailbox=(32, 64))
    slave.configure()
    assert slave.request(P) == (I | 0x10, 0x0016)


def test_20_explicit_device_identification_shows_the_alias_and_clears_it():
    slave = Wired("generic")
    slave.drive.parameters.keep_alias(0x1234)
    from servogym.drive.ethercat.segment import Segment
    from servogym.drive.ethercat.slave import Slave

    slave.slave = Slave(slave.drive)
    from bare_segment import addressed

    slave.segment = addressed(Segment([slave.slave]))
    assert slave.register(0x0012) == 0x1234
    for state in (I, P):
        slave.configure()
        assert slave.request(state, 0x20) == (state | 0x20, 0x1234)
        assert slave.request(state) == (state, 0)
    assert slave.request(0x0F, 0x20) == (P | 0x10, 0x0012), "an error goes first"


def test_21_in_bootstrap_only_foe_is_answered():
    slave = Wired("kollmorgen_akd").to(B)
    read = struct.pack("<BxI", 1, 0) + b"parameters"
    assert slave.ask(4, read)[1][0] == 3, "data"
    for kind in (2, 3, 5, 15):
        assert slave.ask(kind, bytes(10)) == (0, b"\x01\x00\x02\x00"), "unsupported protocol"


# ------------------------------------------------------------------ leaving OPERATIONAL


def enabled(model):
    """A drive in OPERATIONAL that moves at constant speed in csp."""
    slave = wired(model).to(P)
    if model == "kollmorgen_akd":
        slave.assign([0x1724], [0x1B01])
        assert slave.write8(0x6060, 0, 8) == 0
        slave.image = lambda position, word: struct.pack("<iHh", position, word, 0)
    else:
        slave.image = lambda position, word: struct.pack("<HiB", word, position, 8)
    slave.to(S, O)
    slave.period = round(1e-3 / slave.drive.model.cycle_time["position"])
    slave.position = 0
    for word in (6, 7, *[15] * 300):
        if slave.drive.state == State.OPERATION_ENABLED:
            slave.position += 300
        slave.cycle(slave.image(slave.position, word), slave.period)
    assert slave.drive.state == State.OPERATION_ENABLED
    assert abs(slave.shaft.speed) > 1
    return slave


def come_to_rest(slave, cycles=4000):
    slave.shaft.step(cycles)
    assert slave.drive.state in (State.FAULT, State.SWITCH_ON_DISABLED)
    assert not slave.drive.energised


@pytest.mark.parametrize("model", ["generic", "kollmorgen_akd"])
@pytest.mark.parametrize("target", [S, P, I])
def test_19_a_drive_that_leaves_operational_reacts_within_8_periods(model, target):
    slave = enabled(model)
    assert slave.request(target) == (target, 0)
    slave.shaft.step(9 * slave.period)
    assert slave.drive.state != State.OPERATION_ENABLED
    come_to_rest(slave)


def test_18_outputs_that_stay_away_are_a_watchdog_error_and_the_way_back_is_open():
    slave = enabled("generic")
    assert slave.register(0x0440) & 1 == 1
    counted = slave.register(0x0442, 1)
    slave.now += 99_000_000
    slave.segment.poll(slave.now)
    assert slave.register(0x0130) == O, "100 ms by default"
    slave.now += 2_000_000
    slave.segment.poll(slave.now)
    assert (slave.register(0x0130), slave.register(0x0134)) == (S | 0x10, 0x001B)
    assert slave.register(0x0440) & 1 == 0
    assert slave.register(0x0442, 1) == counted + 1
    slave.shaft.step(9 * slave.period)
    assert slave.drive.state != State.OPERATION_ENABLED
    come_to_rest(slave)
    assert slave.request(O) == (S | 0x10, 0x001B)
    assert slave.request(S, 0x10) == (S, 0)
    assert slave.request(O) == (O, 0)
    for word in (0, 0x80, 0, 6, 7, 15, 15, 15):
        slave.cycle(slave.image(0, word), 20)
    assert slave.drive.state == State.OPERATION_ENABLED


@pytest.mark.parametrize(("control", "status"), [(0x64, S | 0x10), (0x24, O)])
def test_the_watchdog_of_the_akd_runs_where_the_master_triggers_it(control, status):
    """Its EEPROM has 24h: without the watchdog; then missing frames are F125 only (5.14)."""
    slave = Wired("kollmorgen_akd").to(P)
    slave.configure()
    slave.sync_manager(2, slave.data.start[0], slave.drive.rpdo_size, control)
    assert slave.request(S) == (S, 0)
    assert slave.request(O) == (O, 0)
    slave.cycle(bytes(6), 4)
    slave.now += 101_000_000
    slave.segment.poll(slave.now)
    assert slave.register(0x0130) == status
    assert slave.register(0x0134) == (0x001B if status != O else 0)


def test_a_drive_at_rest_leaves_operational_without_a_fault():
    slave = wired("generic").to(
        P,
        S,
        O,
    )
    slave.cycle(bytes(slave.drive.rpdo_size), 10)
    slave.request(I)
    slave.shaft.step(100)
    assert slave.drive.state == State.SWITCH_ON_DISABLED
    assert not slave.drive.fault


def test_the_drive_itself_may_retreat():
    slave = wired("generic").to(P, S, O)
    slave.slave.fail(AlStatusCode.FATAL_SYNC_ERROR)
    assert (slave.register(0x0130), slave.register(0x0134)) == (S | 0x10, 0x002C)
    slave.slave.fail(0x8001, P)
    assert (slave.register(0x0130), slave.register(0x0134)) == (P | 0x10, 0x8001)
    slave.slave.fail(0x8002, O)
    assert slave.register(0x0130) == P | 0x10, "never upwards"


# -------------------------------------------------------------------- SYNC unit


@pytest.mark.parametrize(
    ("model", "activation", "cycle", "code"),
    [
        ("generic", 3, 1_000_000, 0),
        ("generic", 3, 500_000, 0),
        ("generic", 3, 750_000, 0x0035),
        ("generic", 3, 0, 0x0035),
        ("generic", 7, 1_000_000, 0x0030),  # SYNC1 is in none of its modes
        ("generic", 1, 1_000_000, 0x0030),
        ("generic", 0, 750_000, 0),
        ("kollmorgen_akd", 3, 250_000, 0),
        ("kollmorgen_akd", 3, 125_000, 0x0035),  # 5.10
        ("festo_cmmp_as", 3, 1_000_000, 0),
        ("festo_cmmp_as", 3, 2_000_000, 0x0035),  # not that of 60C2h, 4.12
    ],
)
def test_38_a_sync0_cycle_the_model_does_not_do_is_refused(model, activation, cycle, code):
    slave = wired(model).to(P)
    slave.configure()
    slave.write(0x09A0, struct.pack("<I", cycle))
    slave.write(0x0981, [activation])
    assert slave.request(S) == ((P | 0x10, code) if code else (S, 0))
