"""Set-points and the function generator: what the axis does is a closed form, within the limits."""

import csv
import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servogym.drive.kernel.words import Mode, State
from servogym.envs.panel.comparison import compare, of_file, write_back
from servogym.envs.panel.generator import KINDS, AxisLimits, travel
from servogym.envs.panel.session import Session
from servogym.envs.plants.linear_axis import linear_axis

sizes = st.floats(0.001, 1.0)


@pytest.fixture
def session():
    machine = linear_axis()
    machine.reset(positions={"x": 0.2})
    session = Session(machine)
    session.enable("x")
    session.write("x", "home_offset", -200_000)
    session.home("x", 35)
    return session


@given(st.floats(-1, 1), sizes, sizes)
def test_a_travel_keeps_speed_and_acceleration_and_arrives_at_rest(way, speed, rate):
    wave, total = travel(way, AxisLimits(speed, rate))
    times = np.linspace(0, total * 1.1 + 1e-6, 2001)
    at = np.array([wave(time) for time in times])
    step = times[1] - times[0]
    velocity = np.diff(at) / step
    assert at[0] == pytest.approx(0, abs=1e-12)
    assert at[-1] == way
    assert np.abs(velocity).max() <= speed * (1 + 1e-6) + 1e-9
    assert np.abs(np.diff(velocity) / step).max() <= rate * (1 + 1e-3) + 1e-6


@given(st.sampled_from([(k, s) for k, kind in KINDS.items() for s in kind.shapes]), sizes, sizes,
       sizes)
def test_a_wave_is_within_the_limits_or_refused(which, size, speed, rate):
    (kind, shape), most = which, AxisLimits(speed, rate)
    frequency = 1 / (2 * travel(1.01 * size, most)[1]) if kind == "position" else rate / 7 / size
    if kind == "velocity" and size > speed:
        with pytest.raises(ValueError, match="choose less"):
            KINDS[kind].wave(shape, size, frequency, most)
        return
    if shape == "sine" and kind == "position":
        frequency /= 2
    wave = KINDS[kind].wave(shape, size, frequency, most)
    times = np.linspace(0, 2 / frequency, 4001)
    at = np.array([wave(time) for time in times])
    assert np.abs(at).max() <= size * (1 + 1e-9)
    if kind == "position":
        assert at[-1] == pytest.approx(0, abs=1e-6)
        slope = np.gradient(at, times)
        assert np.abs(slope).max() <= speed * (1 + 1e-3)
        assert np.abs(np.diff(slope) / np.diff(times)).max() <= rate * 1.02 + 1e-6


def test_a_position_set_point_is_streamed_in_csp_and_reached(session):
    assert session.set_points.set("x", "position", 0.35) == ""
    assert session.machine.drives["x"].mode is Mode.CYCLIC_SYNC_POSITION
    session.advance(0.3)
    assert session.machine.data.qpos[0] == pytest.approx(0.35, abs=1e-4)
    assert "stroke" in session.set_points.set("x", "position", 0.9)
    assert session.machine.data.qpos[0] == pytest.approx(0.35, abs=1e-4)


def test_a_velocity_and_a_torque_act_and_stop_ends_them(session):
    assert session.set_points.set("x", "velocity", 0.05) == ""
    session.advance(0.5)
    assert session.machine.data.qvel[0] == pytest.approx(0.05, rel=0.05)
    assert session.underway == {"x"}
    assert session.stop() == ""
    assert session.set_points.set("x", "torque", 8.0) == ""
    session.advance(0.3)
    assert session.value("x", "torque_actual_value") == pytest.approx(80, abs=3)
    assert session.stop() == ""
    session.advance(0.5)
    assert abs(session.machine.data.qvel[0]) < 2e-3
    assert session.value("x", "target_torque") == 0
    assert "6072h" in session.set_points.set("x", "torque", 1e4)
    assert "6081h" in session.set_points.set("x", "velocity", 1e4)


def test_the_generator_follows_its_sine_and_ends_at_rest_where_it_began(session):
    session.scope.choose(["position_actual_value"])
    session.write("x", "profile_acceleration", 10_000_000)
    begin = session.time
    assert session.set_points.generate("x", "position", "sine", 0.05, 2.0, 2.0) == ""
    n = session.scope.count
    times, at = session.scope._times[:n] - begin, session.scope._ring[0, :n]
    inside = (times > 0.1) & (times < 2.0)
    ideal = 0.2 + 0.025 * (1 - np.cos(2 * np.pi * 2.0 * times[inside]))
    lag = min(np.abs(np.interp(times[inside] - late, times[inside], ideal) - at[inside] * 1e-6)
              [200:].max() for late in np.arange(0, 0.02, 0.0005))
    assert lag < 1e-3
    assert session.machine.drives["x"].state is State.OPERATION_ENABLED
    assert session.machine.data.qpos[0] == pytest.approx(0.2, abs=1e-3)
    assert "speed" in session.set_points.generate("x", "position", "sine", 0.1, 50.0, 1.0)
    assert "stroke" in session.set_points.generate("x", "position", "to and fro", 0.5, 0.1, 1.0)


def test_set_points_without_power_or_in_fault_say_why(session):
    session.disable("x")
    assert "Enable" in session.set_points.set("x", "velocity", 0.01)
    session.machine.drives["x"].inject("overvoltage")
    session.advance(0.05)
    for refused in (
        session.set_points.set("x", "torque", 1),
        session.set_points.generate("x", "torque", "sine", 1, 1, 1),
    ):
        assert "3210h" in refused


# --------------------------------------------------------------- parameters, log


def test_what_differs_from_factory_and_file_is_found_and_written_back(session):
    drive = session.machine.drives["x"]
    session.write("x", "max_torque", 2500)
    file = of_file(session.save_parameters("x"), drive.model.name)
    session.write("x", "max_torque", 2900)
    session.write("x", "position_window", 77)
    found = {each.row.name: each for each in compare(session, "x", file)}
    assert (found["max_torque"].node, found["max_torque"].file) == (2900, 2500)
    assert found["max_torque"].factory == drive.model.names["max_torque"].default
    differ = {each.row: each.file for each in found.values() if each.file not in (None, each.node)}
    assert {row.name for row in differ} == {"max_torque", "position_window"}
    assert write_back(session, "x", differ) == []
    assert drive.read("max_torque") == 2500
    assert not any(e.file not in (None, e.node) for e in compare(session, "x", file))
    with pytest.raises(ValueError, match=r"checksum|damaged|altered|not"):
        of_file(session.save_parameters("x").replace(b"2500", b"2600"), drive.model.name)


def test_the_log_keeps_commands_refusals_faults_and_stops_with_reason_and_remedy(session):
    session.set_points.set("x", "velocity", 0.02)
    session.stop("x")
    session.command("x", "max_torque", 1e9)
    session.machine.drives["x"].inject("overvoltage")
    session.advance(0.05)
    session.home("x")
    rows = list(csv.DictReader(io.StringIO(session.log.csv())))
    kinds = [row["kind"] for row in rows]
    assert {"command", "done", "stop", "refused", "fault"} <= {*kinds}
    fault = next(row for row in rows if row["kind"] == "fault")
    assert fault["reason"].startswith("3210h")
    assert "brake" in fault["remedy"]
    assert "Reset fault and Enable" in rows[-1]["remedy"]
    assert [float(row["time (s)"]) for row in rows] == sorted(float(r["time (s)"]) for r in rows)
