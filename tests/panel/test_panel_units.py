"""The panel shows what people read beside drive units, with every model."""

import pytest
from later import Later, only_with

from servogym.drive.model.model import load, model_names
from servogym.drive.model.rows import quantity

motion = Later("servogym.envs.panel.pages.motion")
SERVOS = [name for name in model_names() if load(name).positions]
MEASURED = {
    "profile_velocity": "velocity", "profile_acceleration": "acceleration",
    "following_error_window": "position", "home_offset": "position", "max_torque": "torque",
    "position_actual_value": "position", "velocity_actual_value": "velocity",
    "torque_actual_value": "torque", "homing_acceleration": "acceleration",
}


@pytest.mark.parametrize("model", SERVOS)
def test_the_unit_of_a_motion_object_is_known_however_the_manual_spells_it(model):
    names = load(model).names
    assert {name: quantity(names[name].unit) for name in MEASURED} == MEASURED


@pytest.mark.parametrize("unit", ["", "ms", "vl velocity unit", "1/min", "rated current/1000"])
def test_another_unit_measures_something_else(unit):
    assert quantity(unit) == ""


@only_with("nicegui", reason="needs servogym[panel]")
@pytest.mark.parametrize("model", SERVOS)
def test_the_jog_speed_is_bounded_by_an_object_of_the_drive(model):
    assert any(name in load(model).names for name in motion.FASTEST)
