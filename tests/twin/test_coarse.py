"""Spindles as they are driven in the wild: a dozen increments a turn, a PID, a winding, 10 ms."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from campaign import stream

from servogym.envs.engine import parameters
from servogym.envs.plants import twins
from servogym.envs.plants.catalogue import of_twin
from servogym.envs.twin import logs
from servogym.envs.twin.families import FAMILIES
from servogym.envs.twin.fit import _voltage
from servogym.training.cli import main

MOTOR = {
    "feed_constant": 0.00028, "tuned": False, "dc_link_voltage": 48.0,
    "motor_torque_constant": 0.043, "motor_resistance": 0.8, "motor_inductance": 0.9e-3,
}
DRIVE = {
    "control_structure": 1, "pid_gain": 50_000, "pid_integral_gain": 1_000,
    "pid_derivative_gain": 420, "encoder_increments": 24, "acceleration_feed_forward": 0,
    "velocity_feed_forward": 0, "link_capacitance": 0, "motor_rated_torque": 100,
    "motor_rated_current": 2_400, "max_torque": 4_800, "max_current": 4_800,
}
HIDDEN = {"rotor_inertia": 3.1e-6, "coulomb_friction": 250.0, "viscous_friction": 6e3,
          "load_force": 90.0, "supply_voltage": 44.5}
COLUMNS = ("time=t:ms,target_position=asked:mm,position_actual_value=is:mm,"
           "torque_actual_value=torque:mNm")
INCREMENT = 0.00028 / 24  # m


def record(file, motor, drive, hidden):
    """Steps of 5 and 10 mm, a sample every 10 ms; -> the file."""
    spindle = FAMILIES["spindle"].given(motor, drive | {"max_motor_speed": 2**31 - 1})
    machine = spindle.make("generic")
    parameters.apply(machine, hidden)
    places = 0.2 + np.repeat([0.0, 0.005, -0.005, 0.005, -0.005, 0.005, -0.005, 0.005], 500)
    rng = np.random.default_rng(2)
    found = stream(machine, "x", places, 1e-3, rng, dropped=0.0, jitter=0.0)
    unit = 1e-3  # mm a position unit
    rated = 1e-3 * drive["motor_rated_torque"]  # mNm a per mille
    with file.open("w", newline="") as text:
        writer = csv.writer(text)
        writer.writerow(["t", "asked", "is", "torque"])
        for n in range(0, len(places), 10):
            asked, place, torque = (
                float(found[name].value[n])
                for name in ("target_position", "position_actual_value", "torque_actual_value")
            )
            writer.writerow([n, round(asked * unit, 2), round(place * unit, 2), torque * rated])
    return file


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return record(tmp_path_factory.mktemp("coarse") / "steps.csv", MOTOR, DRIVE, HIDDEN)


def test_the_voltage_of_the_winding_is_seen_at_the_highest_speed(table):
    spindle = FAMILIES["spindle"].given(MOTOR, DRIVE)
    machine = spindle.make("generic")
    found = logs.read([table], machine, "generic", "x", columns=COLUMNS, mode=8, cycle=1e-3,
                      hold=True)
    assert _voltage(found, parameters.Joint(machine, "x")) == pytest.approx(44.5, rel=0.02)


@pytest.mark.slow
def test_a_coarse_spindle_is_found_to_an_increment(table, tmp_path):
    import json

    (tmp_path / "drive.json").write_text(json.dumps(DRIVE))
    known = [word for name, value in MOTOR.items() for word in ("--set", f"{name}={value}")]
    known = [word.replace("False", "false") for word in known]
    folder = tmp_path / "twin"
    assert main([
        "twin", str(table), "--mechanics", "spindle", *known, "--mode", "8", "--cycle", "1",
        "--read-gains", str(tmp_path / "drive.json"), "--columns", COLUMNS, "--hold",
        "--free", "supply_voltage,pid_gain,pid_integral_gain,pid_derivative_gain",
        "-o", str(folder),
    ]) == 0
    content = json.loads((folder / "twin.json").read_text())
    assert content["held_out"]["position_rms"] < 1.3 * INCREMENT
    found = content["parameters"]
    assert found["supply_voltage"]["value"] == pytest.approx(44.5, rel=0.02)
    assert not twins.read(folder).ranges  # which would not be true
    assert any("no intervals" in text for text in content["doubts"])
    assert "increments of the encoder" in content["said"]
    machine = of_twin(folder)
    assert parameters.get(machine, ["supply_voltage"])["supply_voltage"] == pytest.approx(
        44.5, rel=0.02
    )
