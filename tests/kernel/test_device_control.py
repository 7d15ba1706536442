"""The state machine, walked pair by pair against a table written here from the standard."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import TURN, Shaft
from servogym.drive.drive import Drive
from servogym.drive.kernel.faults import Cause, Reaction
from servogym.drive.kernel.words import State, state_of

S = State
COMMANDS = {
    "shutdown": 0x06,
    "switch on / disable operation": 0x07,
    "enable operation": 0x0F,
    "disable voltage": 0x00,
    "quick stop": 0x02,
    "fault reset": 0x80,
}
# CiA 402-2, transitions 2-12, 15, 16; option codes 605Ah = 6, 605Bh = 605Ch = 0.
# The fault reset pattern is disable voltage with a rising edge of bit 7.
EXPECTED = {
    (S.SWITCH_ON_DISABLED, "shutdown"): (2, S.READY_TO_SWITCH_ON),
    (S.READY_TO_SWITCH_ON, "switch on / disable operation"): (3, S.SWITCHED_ON),
    (S.READY_TO_SWITCH_ON, "enable operation"): (3, S.SWITCHED_ON),
    (S.READY_TO_SWITCH_ON, "disable voltage"): (7, S.SWITCH_ON_DISABLED),
    (S.READY_TO_SWITCH_ON, "fault reset"): (7, S.SWITCH_ON_DISABLED),
    (S.READY_TO_SWITCH_ON, "quick stop"): (7, S.SWITCH_ON_DISABLED),
    (S.SWITCHED_ON, "shutdown"): (6, S.READY_TO_SWITCH_ON),
    (S.SWITCHED_ON, "enable operation"): (4, S.OPERATION_ENABLED),
    (S.SWITCHED_ON, "disable voltage"): (10, S.SWITCH_ON_DISABLED),
    (S.SWITCHED_ON, "fault reset"): (10, S.SWITCH_ON_DISABLED),
    (S.SWITCHED_ON, "quick stop"): (10, S.SWITCH_ON_DISABLED),
    (S.OPERATION_ENABLED, "shutdown"): (8, S.READY_TO_SWITCH_ON),
    (S.OPERATION_ENABLED, "switch on / disable operation"): (5, S.SWITCHED_ON),
    (S.OPERATION_ENABLED, "disable voltage"): (9, S.SWITCH_ON_DISABLED),
    (S.OPERATION_ENABLED, "fault reset"): (9, S.SWITCH_ON_DISABLED),
    (S.OPERATION_ENABLED, "quick stop"): (11, S.QUICK_STOP_ACTIVE),
    (S.QUICK_STOP_ACTIVE, "disable voltage"): (12, S.SWITCH_ON_DISABLED),
    (S.QUICK_STOP_ACTIVE, "fault reset"): (12, S.SWITCH_ON_DISABLED),
    (S.QUICK_STOP_ACTIVE, "enable operation"): (16, S.OPERATION_ENABLED),
    (S.FAULT, "fault reset"): (15, S.SWITCH_ON_DISABLED),
}
WAY = {
    S.SWITCH_ON_DISABLED: (),
    S.READY_TO_SWITCH_ON: (0x06,),
    S.SWITCHED_ON: (0x06, 0x07),
    S.OPERATION_ENABLED: (0x06, 0x07, 0x0F),
    S.QUICK_STOP_ACTIVE: (0x06, 0x07, 0x0F, 0x0B),
}
POWERED = (S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE, S.FAULT_REACTION_ACTIVE)


def in_state(state, **objects):
    shaft = Shaft()
    objects = {
        "quick_stop_option_code": 6,
        "shutdown_option_code": 0,
        "disable_operation_option_code": 0,
    } | objects
    shaft.write(**objects)
    if state in (S.FAULT, S.FAULT_REACTION_ACTIVE):
        if state == S.FAULT_REACTION_ACTIVE:  # a ramp from speed keeps the reaction going
            shaft.enable(3)
            shaft.write(target_velocity=10_000_000)
            shaft.step(500)
        shaft.drive.inject(Cause.EXTERNAL)
        shaft.step()
        shaft.drive.clear_injected()
        shaft.step()
    for word in WAY.get(state, ()):
        shaft.control(word, 1)
    assert shaft.drive.state == state
    return shaft


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("state", [*WAY, S.FAULT_REACTION_ACTIVE, S.FAULT])
def test_every_pair_is_a_row_of_the_table_or_ignored(state, command):
    shaft = in_state(state)
    before = shaft.axis.transition
    shaft.control(COMMANDS[command], 1)
    number, target = EXPECTED.get((state, command), (before, state))
    assert shaft.drive.state == target
    assert shaft.axis.transition == number
    assert state_of(shaft.read("statusword")) == target
    assert (target in POWERED) or shaft.axis.torque == 0.0


def test_power_on_passes_the_self_test():
    drive = Drive()
    assert drive.state == S.NOT_READY_TO_SWITCH_ON
    drive.cycle(0.0)
    assert drive.state == S.SWITCH_ON_DISABLED
    assert drive.axis.transition == 1


@pytest.mark.parametrize("state", WAY)
def test_a_fault_leads_from_every_state_over_the_reaction_to_fault(state):
    shaft = in_state(state)
    shaft.drive.inject("external")
    seen = []
    shaft.after = lambda: seen.append(shaft.drive.state)
    shaft.step(5)
    assert seen[-1] == S.FAULT
    assert shaft.axis.transition == 14
    assert shaft.read("error_code") == 0x9000
    assert shaft.read("error_register") & 1


def test_enable_operation_in_ready_passes_through_switched_on():
    shaft = in_state(S.READY_TO_SWITCH_ON)
    seen = []
    shaft.after = lambda: seen.append((shaft.axis.transition, shaft.drive.state))
    shaft.control(0x0F, 2)
    assert seen == [(3, S.SWITCHED_ON), (4, S.OPERATION_ENABLED)]


def test_fault_reset_needs_a_rising_edge_and_the_cause_gone():
    shaft = in_state(S.FAULT)
    shaft.drive.inject("external")
    shaft.step()
    shaft.control(0x80)
    assert shaft.drive.state == S.FAULT
    assert "EXTERNAL" in shaft.drive.why()
    shaft.drive.clear_injected()
    shaft.step(5)
    assert shaft.drive.state == S.FAULT, "the bit is still set, but there is no new edge"
    shaft.control(0x00)
    shaft.control(0x80)
    assert shaft.drive.state == S.SWITCH_ON_DISABLED
    assert shaft.read("error_register") == 0


def running(**objects):
    shaft = Shaft()
    shaft.write(
        profile_acceleration=100_000_000, profile_deceleration=50_000_000,
        quick_stop_deceleration=200_000_000, target_velocity=10_000_000, **objects,
    )
    shaft.enable(3)
    shaft.step(600)
    assert abs(shaft.read("velocity_actual_value") - 10_000_000) < 50_000
    return shaft


def measured_ramp(shaft, cycles):
    """Deceleration of the demand (units/s²) over the next cycles."""
    speeds = []
    shaft.after = lambda: speeds.append(shaft.axis.velocity_demand)
    shaft.step(cycles)
    shaft.after = None
    unit = shaft.axis.rad_s_per_velocity_unit
    return (speeds[0] - speeds[-1]) / unit / ((cycles - 1) * shaft.axis.position_period)


@pytest.mark.parametrize(
    ("code", "ramp", "end"),
    [
        (1, 50e6, S.SWITCH_ON_DISABLED),
        (2, 200e6, S.SWITCH_ON_DISABLED),
        (3, None, S.SWITCH_ON_DISABLED),
        (4, None, S.SWITCH_ON_DISABLED),
        (5, 50e6, S.QUICK_STOP_ACTIVE),
        (6, 200e6, S.QUICK_STOP_ACTIVE),
        (7, None, S.QUICK_STOP_ACTIVE),
        (8, None, S.QUICK_STOP_ACTIVE),
    ],
)
def test_quick_stop_option_code(code, ramp, end):
    shaft = running(quick_stop_option_code=code)
    shaft.control(0x0B, 1)
    assert shaft.drive.state == S.QUICK_STOP_ACTIVE
    if ramp is None:
        assert shaft.axis.velocity_demand == 0.0, "no ramp: the velocity controller brakes"
    else:
        assert measured_ramp(shaft, 20) == pytest.approx(ramp, rel=1e-6)
    shaft.step(3000)
    assert shaft.drive.state == end
    assert abs(shaft.axis.velocity) <= shaft.axis.velocity_threshold
    if end == S.QUICK_STOP_ACTIVE:
        shaft.control(0x0F, 600)
        assert shaft.drive.state == S.OPERATION_ENABLED
        assert shaft.read("velocity_actual_value") == pytest.approx(10e6, rel=0.01)


def test_target_reached_tells_the_end_of_a_quick_stop():
    """CiA 402-2, statusword bit 10 with 605Ah = 5..8; in pv the target was reached before."""
    shaft = running(quick_stop_option_code=6)
    shaft.until(lambda: shaft.bit(0x0400))
    shaft.control(0x02, 4)
    assert shaft.drive.state == S.QUICK_STOP_ACTIVE
    assert not shaft.bit(0x0400)
    shaft.until(lambda: shaft.bit(0x0400))
    assert shaft.drive.state == S.QUICK_STOP_ACTIVE
    assert shaft.read("velocity_actual_value") == pytest.approx(0, abs=20_000)  # 606Fh


def test_quick_stop_option_0_disables_at_once():
    shaft = running(quick_stop_option_code=0)
    shaft.control(0x0B, 1)
    assert shaft.drive.state == S.SWITCH_ON_DISABLED
    assert shaft.axis.torque == 0.0
    assert shaft.speed > 1


def test_transition_16_needs_option_codes_5_to_8():
    shaft = running(quick_stop_option_code=2)
    shaft.control(0x0B, 1)
    shaft.control(0x0F, 1)
    assert shaft.drive.state == S.QUICK_STOP_ACTIVE


@pytest.mark.parametrize(
    ("name", "word", "end"),
    [
        ("disable_operation_option_code", 0x07, S.SWITCHED_ON),
        ("shutdown_option_code", 0x06, S.READY_TO_SWITCH_ON),
    ],
)
def test_shutdown_and_disable_operation_ramp_or_coast(name, word, end):
    shaft = running(**{name: 0})
    shaft.control(word, 1)
    assert shaft.drive.state == end
    shaft = running(**{name: 1})
    shaft.control(word, 1)
    assert shaft.drive.state == S.OPERATION_ENABLED, "the ramp comes first"
    assert measured_ramp(shaft, 20) == pytest.approx(50e6, rel=1e-6)
    shaft.control(0x0F, 500)  # called off: the mode goes on
    assert shaft.read("velocity_actual_value") == pytest.approx(10e6, rel=0.01)
    shaft.control(word, 2000)
    assert shaft.drive.state == end
    assert abs(shaft.speed) < 0.2


@pytest.mark.parametrize(("code", "ramp"), [(1, 50e6), (2, 200e6), (3, None), (4, None)])
def test_halt_option_code(code, ramp):
    shaft = running(halt_option_code=code)
    shaft.control(0x10F, 1)
    if ramp:
        assert measured_ramp(shaft, 20) == pytest.approx(ramp, rel=1e-6)
    shaft.step(1500)
    assert shaft.drive.state == S.OPERATION_ENABLED
    assert shaft.bit(0x0400), "target reached says that the halted axis stands"
    assert abs(shaft.speed) < 0.2
    shaft.control(0x0F, 600)
    assert shaft.read("velocity_actual_value") == pytest.approx(10e6, rel=0.01)


@pytest.mark.parametrize(("code", "ramp"), [(0, 0), (1, 50e6), (2, 200e6), (3, None), (4, None)])
def test_fault_reaction_option_code(code, ramp):
    shaft = running(fault_reaction_option_code=code)
    shaft.drive.inject("external")
    shaft.step(2)
    if ramp == 0:
        assert shaft.drive.state == S.FAULT
        assert shaft.speed > 1
        return
    assert shaft.drive.state == S.FAULT_REACTION_ACTIVE
    if ramp:
        assert measured_ramp(shaft, 20) == pytest.approx(ramp, rel=1e-6)
    shaft.step(3000)
    assert shaft.drive.state == S.FAULT
    assert abs(shaft.speed) < 0.2


@pytest.mark.parametrize("mode", [1, 2, 3, 4, 6, 7, 8, 9, 10])
def test_quick_stop_ends_in_every_mode(mode):
    shaft = Shaft()
    shaft.write(target_velocity=5_000_000, target_torque=100, vl_target_velocity=300)
    shaft.write(target_position=3_000_000, homing_method=34)
    shaft.enable(mode)
    shaft.control(0x7F, 200)
    shaft.control(0x0B, 4000)
    assert shaft.drive.state == S.SWITCH_ON_DISABLED
    assert abs(shaft.speed) < 0.2


def test_missing_enable_input_and_sto_take_the_power_away_and_say_so():
    shaft = running()
    shaft.axis.sto_input = 0
    shaft.step()
    assert shaft.drive.state == S.SWITCH_ON_DISABLED
    assert shaft.axis.torque == 0.0
    assert not shaft.bit(0x10)
    shaft.control(0x06)
    assert shaft.drive.state == S.SWITCH_ON_DISABLED
    shaft = running()
    shaft.axis.enable_input = 0
    shaft.step(2)
    assert shaft.drive.state == S.QUICK_STOP_ACTIVE, "without the enable input it brakes first"
    shaft.step(2000)
    assert shaft.drive.state == S.SWITCH_ON_DISABLED


@pytest.mark.parametrize("first", ["fault", "safe torque off", "both"])
def test_safe_torque_off_ends_a_fault_reaction_at_once(first):
    """IEC 61800-5-2, STO: no power that can cause torque, whatever the state."""
    shaft = running(brake_fitted=0)
    shaft.write(fault_reaction_option_code=1)
    if first == "fault":
        shaft.drive.inject("external")
        shaft.step(20)
        assert shaft.drive.state == S.FAULT_REACTION_ACTIVE
        assert shaft.torque != 0.0
    if first != "fault":
        shaft.axis.sto_input = 0
        if first == "both":
            shaft.drive.inject("external")
        shaft.step()
        assert shaft.torque == 0.0
        shaft.drive.inject("external")
    shaft.axis.sto_input = 0
    shaft.step()
    assert shaft.torque == 0.0
    shaft.step()
    assert shaft.drive.state == S.FAULT
    assert shaft.speed > 1, "it coasts"


@pytest.mark.parametrize("model", ["festo_cmmp_as", "metronix_ars2000"])
def test_a_torque_mode_coasts_without_the_controller_enable_in_a_fault_reaction_too(model):
    """Festo CMMP-AS 5.4, Metronix ARS 2000 6.4.2.1."""
    shaft = Shaft(model)
    shaft.write(target_torque=200, torque_slope=10**6)
    shaft.enable(4)
    shaft.step(40)
    shaft.axis.od.fault_reaction[Cause.OVERSPEED] = Reaction.QUICK_STOP
    shaft.drive.inject("overspeed")
    shaft.step(3)
    assert shaft.drive.state == S.FAULT_REACTION_ACTIVE
    shaft.axis.enable_input = 0
    shaft.step(2)
    assert shaft.drive.state == S.FAULT
    assert shaft.torque == 0.0


# CiA 402-2, 6007h: no action, fault signal, disable voltage, quick stop
ABORTED = {
    S.READY_TO_SWITCH_ON: (S.READY_TO_SWITCH_ON, S.FAULT, S.SWITCH_ON_DISABLED,
                           S.SWITCH_ON_DISABLED),
    S.SWITCHED_ON: (S.SWITCHED_ON, S.FAULT, S.SWITCH_ON_DISABLED, S.SWITCH_ON_DISABLED),
    S.OPERATION_ENABLED: (S.OPERATION_ENABLED, S.FAULT, S.SWITCH_ON_DISABLED,
                          S.QUICK_STOP_ACTIVE),
    S.QUICK_STOP_ACTIVE: (S.QUICK_STOP_ACTIVE, S.FAULT, S.SWITCH_ON_DISABLED,
                          S.QUICK_STOP_ACTIVE),
}


@pytest.mark.parametrize("code", range(4))
@pytest.mark.parametrize("state", ABORTED)
def test_a_lost_connection_leads_where_6007h_says(state, code):
    shaft = in_state(state, abort_connection_option_code=code)
    shaft.axis.connection_lost = 1
    shaft.step(200)
    assert shaft.drive.state == ABORTED[state][code]
    assert (shaft.read("error_code") != 0) == (code == 1)


@pytest.mark.parametrize(
    ("code", "state"),
    [(0, S.OPERATION_ENABLED), (1, S.FAULT), (2, S.SWITCH_ON_DISABLED), (3, S.SWITCH_ON_DISABLED)],
)
def test_abort_connection_option_code(code, state):
    shaft = running(abort_connection_option_code=code)
    shaft.axis.connection_lost = 1
    shaft.step(3000)
    assert shaft.drive.state == state


def test_why_names_command_state_and_what_is_missing():
    shaft = Shaft()
    assert shaft.drive.why() == "no command has been refused"
    shaft.control(0x0F)
    assert "ENABLE_OPERATION was refused in SWITCH_ON_DISABLED" in shaft.drive.why()
    assert "0006h" in shaft.drive.why()


def chaos(data, steps):
    """Random words, modes, targets, inputs and feedback: power only where it may be."""
    shaft = Shaft()
    shaft.drive.write("following_error_window", 0xFFFFFFFF)
    for _ in range(steps):
        kind = data.draw(st.integers(0, 9))
        if kind < 5:
            shaft.drive.axis.od.controlword = data.draw(
                st.sampled_from([0, 2, 6, 7, 0xB, 0xF, 0x1F, 0x3F, 0x5F, 0x7F, 0x80, 0x10F, 0x21F])
                | st.integers(0, 0xFFFF)
            )
        elif kind == 5:
            shaft.drive.axis.od.modes_of_operation = data.draw(st.integers(-128, 127))
        elif kind == 6:
            shaft.drive.axis.od.target_position = data.draw(st.integers(-(2**31), 2**31 - 1))
            shaft.drive.axis.od.target_velocity = data.draw(st.integers(-(2**31), 2**31 - 1))
            shaft.drive.axis.od.target_torque = data.draw(st.integers(-(2**15), 2**15 - 1))
        elif kind == 7:
            shaft.drive.axis.injected = data.draw(st.sampled_from([0, 0, 0, 2, 1 << 12]))
        elif kind == 8:
            shaft.angle = data.draw(st.sampled_from([0.0, 1.0, float("nan"), float("inf"), 1e300]))
            shaft.speed = 0.0
        else:
            shaft.axis.sto_input = data.draw(st.integers(0, 1))
            shaft.axis.positive_limit_switch = data.draw(st.integers(0, 1))
        shaft.axis.parameters_changed = 1
        for _ in range(data.draw(st.integers(1, 8))):
            shaft.step()
            assert state_of(shaft.read("statusword")) == shaft.drive.state
            if shaft.drive.state not in POWERED:
                assert shaft.torque == 0.0
            assert abs(shaft.torque) <= 3.82
            if not abs(shaft.angle) < 1e6 * TURN:
                assert shaft.torque == 0.0
                shaft.angle = shaft.speed = 0.0


@given(st.data())
def test_random_masters_never_power_the_motor_outside_its_states(data):
    chaos(data, 20)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(10))
def test_random_masters_long(part):
    """10,000 in all; each part draws its own."""
    tenth = settings(settings.get_profile("long"), max_examples=1_000)
    tenth(given(st.data())(lambda data: chaos(data, 30)))()
