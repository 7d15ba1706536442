"""What surrounds the motion: encoder, cascade, brake, heat, DC link, touch probe, faults."""

import numpy as np
import pytest

from conftest import INCREMENTS, INERTIA, TURN, Shaft
from servogym.drive.model.model import load
from servogym.drive.objects.abort import Abort, SdoAbort

LIMIT = 0x0800


def test_the_encoder_counts_whole_increments_from_power_on():
    shaft = Shaft()
    shaft.drive.cycle(10.4 / INCREMENTS * TURN)
    assert shaft.read("position_actual_value") == 10
    shaft.drive.cycle(-0.4 / INCREMENTS * TURN)
    assert shaft.read("position_actual_value") == -1


@pytest.mark.parametrize("angle", [float("nan"), float("inf"), -float("inf"), 1e300])
def test_feedback_that_is_no_number_is_a_fault_and_no_torque(angle, enabled):
    before = enabled.read("position_actual_value")
    assert enabled.drive.cycle(angle) == 0.0
    assert enabled.drive.state.name == "FAULT"
    assert enabled.read("error_code") == 0x7305
    assert enabled.read("position_actual_value") == before
    assert "not a finite number" in enabled.drive.fault


def test_the_integrator_does_not_wind_up_behind_the_torque_limit(shaft):
    shaft.write(target_velocity=5_000_000)
    shaft.blocked = 0.0
    shaft.enable(3)
    shaft.step(2000)
    assert shaft.read("active_limits") & 1
    assert shaft.axis.velocity_integral <= 3.82
    shaft.blocked = None
    speeds = []
    shaft.after = lambda: speeds.append(shaft.speed)
    shaft.step(600)
    goal = 5_000_000 / INCREMENTS * TURN
    outside = [n for n, speed in enumerate(speeds) if abs(speed - goal) > 0.02 * goal]
    assert outside[-1] < 150, "in the band within 75 ms"


def test_the_current_loop_is_a_first_order_lag(shaft):
    shaft.blocked = 0.0
    shaft.enable(10)
    shaft.write(target_torque=1000)
    shaft.step(1)
    expected = 1.27 * (1 - np.exp(-2 * 250e-6 / 300e-6))
    assert shaft.torque == pytest.approx(expected, rel=1e-9)


def test_the_velocity_loop_meets_its_design(shaft):
    shaft.write(target_velocity=2_000_000, profile_acceleration=4_000_000_000)
    shaft.enable(3)
    speeds = []
    shaft.after = lambda: speeds.append(shaft.speed)
    shaft.step(200)
    goal = 2_000_000 / INCREMENTS * TURN
    assert speeds[-1] == pytest.approx(goal, rel=2e-3)
    assert max(speeds) < 1.6 * goal, "overshoot of a symmetrical optimum"


def test_overspeed_takes_the_power_away(shaft):
    shaft.write(max_motor_speed=600, target_torque=1000, torque_slope=10**6)
    shaft.enable(10)
    shaft.load = 1.5
    shaft.until(lambda: shaft.read("error_code") == 0x8400, 4000)
    shaft.step()
    assert shaft.torque == 0.0


def vertical(shaft, grip):
    """A load that hangs on the shaft; the brake holds it while `brake_released` is 0."""
    shaft.load = -0.8
    state = {"since": 0, "held": True}

    def brake():
        released = bool(shaft.axis.brake_released)
        state["since"] = 0 if released == (not state["held"]) else state["since"] + 1
        if released == state["held"] and state["since"] >= grip:
            state["held"] = not released
        if state["held"]:
            shaft.speed, shaft.angle = 0.0, state.setdefault("angle", shaft.angle)
        else:
            state.pop("angle", None)

    shaft.after = brake


def sag(engage_time):
    """Turns the load moves while the axis is enabled, held and disabled again."""
    shaft = Shaft()
    shaft.write(brake_fitted=1, brake_release_time=60, brake_engage_time=engage_time)
    shaft.write(following_error_window=0xFFFFFFFF)
    vertical(shaft, grip=60)  # position cycles: the brake itself takes 30 ms
    shaft.step(20)
    shaft.enable(8)
    places = []
    brake = shaft.after
    shaft.after = lambda: (brake(), places.append(shaft.angle))
    shaft.step(400)
    assert shaft.axis.brake_released
    shaft.control(0x07, 400)
    assert shaft.drive.state.name == "SWITCHED_ON"
    assert not shaft.axis.brake_released
    return (max(places) - min(places)) / TURN


def test_a_vertical_axis_does_not_sag_with_brake_delays():
    assert sag(engage_time=40) < 0.02
    assert sag(engage_time=0) > 0.2, "the same without the delay: the load falls"


def test_the_brake_can_be_released_by_hand_while_the_motor_is_off():
    shaft = Shaft()
    shaft.write(brake_fitted=1)
    shaft.step(2)
    assert not shaft.axis.brake_released
    shaft.write(bit_mask=1, physical_outputs=0)
    shaft.step()
    assert shaft.axis.brake_released
    shaft.write(physical_outputs=1)
    shaft.step()
    assert not shaft.axis.brake_released


def test_i2t_reduces_the_torque_to_the_rated_one_and_warns(shaft):
    shaft.blocked = 0.0
    shaft.write(target_torque=3000, i2t_time=500, torque_slope=10**6)
    shaft.enable(10)
    shaft.step(800)
    assert shaft.torque == pytest.approx(3.81, rel=1e-3)
    shaft.step(8000)
    assert shaft.torque == pytest.approx(1.27, rel=0.05)
    assert shaft.read("active_limits") & 0x40
    assert shaft.bit(0x0080), "warning"
    assert shaft.read("i2t_level") > 950
    shaft.write(target_torque=0)
    shaft.step(12_000)
    assert shaft.read("i2t_level") < 200
    assert not shaft.bit(0x0080)


def test_the_motor_grows_warm_by_its_time_constant_and_faults_at_its_limit(shaft):
    shaft.blocked = 0.0
    shaft.write(motor_thermal_time=2, target_torque=1000, i2t_time=0, torque_slope=10**6)
    shaft.enable(10)
    shaft.step(4000)
    heating = 45 * 1.8 * (1 - np.exp(-1))
    assert shaft.read("motor_temperature") == pytest.approx(250 + 10 * heating, rel=0.03)
    shaft.write(motor_temperature_limit=700)
    shaft.until(lambda: shaft.read("error_code") == 0x4310)


def test_braking_charges_the_dc_link_and_the_chopper_takes_the_energy():
    """All the kinetic energy of the shaft ends as heat or charge."""
    shaft = Shaft()
    shaft.write(profile_deceleration=500_000_000, profile_acceleration=500_000_000)
    shaft.write(following_error_window=0xFFFFFFFF, link_capacitance=20, target_velocity=60_000_000)
    shaft.enable(3)
    shaft.step(800)
    kinetic = INERTIA / 2 * shaft.speed**2
    before = shaft.read("dc_link_circuit_voltage") * 1e-3
    shaft.write(target_velocity=0)
    voltages = []
    shaft.after = lambda: voltages.append(shaft.read("dc_link_circuit_voltage") * 1e-3)
    shaft.step(800)
    assert max(voltages) > 390
    assert max(voltages) < 430
    stored = 20e-6 / 2 * (voltages[-1] ** 2 - before**2)
    heat = shaft.read("chopper_energy") * 1e-3
    assert stored + heat == pytest.approx(kinetic, rel=0.1)


def test_without_a_chopper_it_is_an_overvoltage():
    shaft = Shaft()
    shaft.write(profile_deceleration=500_000_000, profile_acceleration=500_000_000)
    shaft.write(link_capacitance=20, target_velocity=60_000_000, chopper_resistance=0)
    shaft.enable(3)
    shaft.step(800)
    shaft.write(target_velocity=0)
    shaft.until(lambda: shaft.read("error_code") == 0x3210, 2000)
    assert shaft.torque == 0.0


def test_undervoltage(enabled):
    enabled.write(supply_voltage=100_000, link_capacitance=0)
    enabled.step(2)
    assert enabled.read("error_code") == 0x3220
    assert not enabled.bit(0x10)


@pytest.mark.parametrize("cause", [fault.cause for fault in load("generic").faults])
def test_every_cause_can_be_injected_and_is_what_the_model_says(cause, enabled):
    enabled.drive.inject(cause.name.lower())
    enabled.step(2)
    fault = next(f for f in enabled.drive.model.faults if f.cause == cause)
    assert enabled.read("error_code") == fault.code
    assert enabled.read("error_register") == 1 | 1 << fault.register
    if fault.reaction.name == "WARNING":
        assert enabled.bit(0x80)
        assert enabled.drive.state.name == "OPERATION_ENABLED"
    else:
        enabled.step(2500)
        assert enabled.drive.state.name == "FAULT"
        assert f"{fault.code:04X}h" in enabled.drive.fault
    enabled.drive.clear_injected()


@pytest.mark.parametrize(
    ("reaction", "state", "warning"),
    [(0, "OPERATION_ENABLED", False), (1, "OPERATION_ENABLED", True), (2, "FAULT", False)],
)
def test_a_following_error_is_a_fault_a_warning_or_only_bit_13(reaction, state, warning, enabled):
    enabled.write(reaction_to_following_error=reaction, following_error_window=100)
    enabled.write(modes_of_operation=8)
    enabled.load = 0.5
    enabled.until(lambda: enabled.axis.following_error_exceeded, 400)
    assert enabled.bit(0x2000)
    enabled.load = 0.0
    assert enabled.bit(0x80) == warning
    enabled.step(1)
    enabled.until(lambda: enabled.drive.state.name == state, 3000)


def test_a_severe_cause_cannot_be_made_harmless(shaft):
    with pytest.raises(SdoAbort) as error:
        shaft.write(reaction_to_overvoltage=1)
    assert error.value.code == Abort.VALUE_TOO_LOW


def test_an_unknown_cause_names_the_known_ones(shaft):
    with pytest.raises(ValueError, match="encoder_loss, following_error"):
        shaft.drive.inject("gremlins")


def test_touch_probe_stores_first_or_every_edge(shaft):
    def at(position, level):
        shaft.axis.touch_probe[0] = level
        shaft.drive.cycle(position / INCREMENTS * TURN)

    shaft.write(touch_probe_function=0x01 | 0x10 | 0x20)
    at(100.5, 0)
    at(200.5, 1)
    at(300.5, 0)
    at(400.5, 1)
    assert shaft.read("touch_probe_1_positive_edge") == 200
    assert shaft.read("touch_probe_1_negative_edge") == 300
    assert shaft.read("touch_probe_status") == 0x07
    shaft.write(touch_probe_function=0)
    at(500.5, 0)
    assert shaft.read("touch_probe_status") == 0
    shaft.write(touch_probe_function=0x01 | 0x02 | 0x10)
    at(600.5, 1)
    at(700.5, 0)
    at(800.5, 1)
    assert shaft.read("touch_probe_1_positive_edge") == 800, "continuous"


def test_touch_probe_2_on_the_index_pulse_is_exact(shaft):
    shaft.write(touch_probe_function=(0x01 | 0x04 | 0x10) << 8)
    for turn in (0.4, 0.9, 1.3):
        shaft.drive.cycle(turn * TURN)
    assert shaft.read("touch_probe_2_positive_edge") == INCREMENTS
    assert shaft.read("touch_probe_status") == 0x0300


def test_normally_closed_switches(shaft):
    shaft.write(switch_polarity=3)
    shaft.step()
    assert shaft.read("digital_inputs") == 3, "open wires read as active"
    shaft.axis.negative_limit_switch = 1
    shaft.axis.positive_limit_switch = 1
    shaft.step()
    assert shaft.read("digital_inputs") == 0
