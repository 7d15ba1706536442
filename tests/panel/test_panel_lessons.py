"""Lessons, disturbances, policies that take over, and what is drawn: without a browser."""

import json
from itertools import count

import numpy as np
import pytest

from servogym.drive.diagrams import HOME, NEGATIVE, POSITIVE, homing_path, transitions
from servogym.drive.kernel.homing import HERE, NUMBERS
from servogym.drive.kernel.words import State
from servogym.envs import Machine, commission_joint, gantry, rotary_axis
from servogym.envs.course.exercise import named
from servogym.envs.panel.bench import Interrupted
from servogym.envs.panel.disturbances import DISTURBANCES, disturb, inject
from servogym.envs.panel.geometry import Poses, scene
from servogym.envs.panel.lessons import Pupil
from servogym.envs.panel.pages.homing_diagram import homing_svg
from servogym.envs.panel.session import Session
from servogym.envs.plants.catalogue import AXES
from servogym.envs.plants.linear_axis import linear_axis
from servogym.envs.tasks.fitting import FITTING, NONE, robot
from servogym.envs.tasks.robot import ARM
from servogym.training.policies.takeover import Laboratory, TakeOver


@pytest.fixture
def session():
    machine = linear_axis()
    machine.reset(positions={"x": 0.12})
    machine.step(4)
    return Session(machine, "test")


@pytest.fixture
def homed(session):
    assert session.enable("x") == ""
    assert session.home("x") == ""
    assert session.move("x", 0.1) == ""
    return session


def test_an_exercise_begins_with_a_fresh_machine_and_is_judged_as_it_runs(session):
    session.write("x", "max_torque", 100)
    disturb(session, "x", DISTURBANCES[1], 300.0)
    pupil = session.pupil = Pupil(session, "x", named("13_overvoltage"))
    assert session.machine.drives["x"].read("max_torque") == 3000
    assert DISTURBANCES[1].read(session, 0) == 0.0
    assert pupil.present.text == "Enable the drive."
    assert session.enable("x") == ""
    session.advance(0.1)
    assert (pupil.present.step, pupil.present.asks) == (1, True)
    assert pupil.attempt.predict(1)
    session.reset_fault("x")
    session.advance(0.1)
    assert pupil.present.step == 2
    session.machine.drives["x"].clear_injected()
    session.reset_fault("x")
    assert session.enable("x") == ""
    session.advance(0.1)
    assert pupil.attempt.done
    assert pupil.present.text == ""


def test_a_wrong_way_is_named_and_the_exercise_lost(session):
    pupil = session.pupil = Pupil(session, "x", named("11_power"))
    assert session.enable("x") == ""
    assert "has left Switch on disabled" in pupil.present.wrong
    assert any("Begin the exercise again" in str(message) for message in session.messages)


# ------------------------------------------------------- disturbances, policies


def test_disturbances_act_and_out_of_range_they_are_refused(homed):
    for row in DISTURBANCES:
        assert "out of range" in disturb(homed, "x", row, row.most * 2)
        assert disturb(homed, "x", row, 3.0) == ""
        assert row.read(homed, 0) == pytest.approx(3.0 * row.scale)
    homed.advance(0.2)
    homed.scope.set_window(0.2, 0.0)
    homed.advance(0.2)
    assert homed.scope.view().values[0].std() > 0  # encoder noise is seen
    assert "unknown cause" in inject(homed, "x", "nonsense")


def test_commands_come_late_by_their_delay_and_motions_still_end(homed):
    homed.delay = 0.02
    begin = homed.time
    homed.masters["x"].port.write("x", "target_torque", 7)
    homed.advance(0.018)
    assert homed.machine.drives["x"].read("target_torque") == 0
    homed.advance(0.004)
    assert homed.machine.drives["x"].read("target_torque") == 7
    assert homed.move("x", 0.2) == ""
    assert homed.time - begin > 0.04
    assert homed.shown()["axes"]["x"]["position"] == pytest.approx(200, abs=0.03)


def test_a_policy_takes_over_brings_the_axis_to_the_goal_and_gives_back(homed):
    before = len(homed.shown()["axes"]["x"]["rpdo"])
    homed.hand_over(Laboratory().agent(homed, "x", "ruckig", 300))
    assert "has the machine" in homed.move("x", 0.2)
    samples = homed.scope.count
    homed.advance(1.0)
    assert homed.scope.count - samples == pytest.approx(1.0 / homed.scope.period, abs=12)
    assert homed.shown()["axes"]["x"]["position"] == pytest.approx(300, abs=0.05)
    homed.release()
    assert len(homed.shown()["axes"]["x"]["rpdo"]) == before
    assert homed.move("x", 0.2) == ""


def test_a_machine_taken_back_in_the_middle_of_a_step_comes_to_rest(homed):
    homed.hand_over(Laboratory().agent(homed, "x", "ruckig", 300))
    homed.advance(0.06)
    calls = count()
    homed.pace = lambda: homed.release() if next(calls) == 3 else None
    with pytest.raises(Interrupted):  # which the clock expects
        homed.agent.step()
    homed.pace = lambda: None
    homed.exchange()
    with pytest.raises(ValueError, match="the axis moves: stop it first"):
        Laboratory().agent(homed, "x", "ruckig", 300)
    homed.advance(0.3)
    seen = homed.shown()["axes"]["x"]
    assert State(seen["state"]) is State.OPERATION_ENABLED
    assert seen["velocity"] == pytest.approx(0, abs=1)
    assert homed.move("x", 0.2) == ""


def test_a_table_is_turned_to_the_goal_the_shorter_way():
    machine = rotary_axis()
    machine.reset(positions={"x": 0.2})
    session, laboratory = Session(machine), Laboratory(lambda axis: FITTING["rotary-table"])
    assert session.enable("x") == session.home("x", 35) == ""
    session.hand_over(laboratory.agent(session, "x", "ruckig", 350))
    session.advance(1.0)
    assert session.shown()["axes"]["x"]["position"] == pytest.approx(350, abs=0.03)
    assert machine.data.qpos[0] == pytest.approx(0.2 - np.radians(10), abs=1e-3)
    session.release()
    assert session.move("x", np.radians(20)) == ""
    ruckig, slower = laboratory.compare(machine, "x", ["ruckig", "proportional"], 100)
    assert ruckig.settling_time < slower.settling_time
    assert ruckig.value[-1] == pytest.approx(100, abs=0.03)


def test_two_axes_of_a_gantry_drive_a_circle_and_are_given_back():
    machine = gantry()
    machine.reset(positions={"x": 0.3, "y": 0.2, "z": -0.1})
    session, laboratory = Session(machine), Laboratory(lambda axis: FITTING["gantry"])
    session.enable("x"), session.home("x", 17), session.enable("y")
    with pytest.raises(ValueError, match="y: the axis is not referenced"):
        laboratory.agent(session, "x", "full_feed", 40)
    session.home("y", 37)
    with pytest.raises(ValueError, match=r"y: the drive's zero .* home it with method 17"):
        laboratory.agent(session, "x", "full_feed", 40)
    session.home("y", 17)
    session.hand_over(laboratory.agent(session, "x", "full_feed", 40))
    session.advance(0.4)
    for _ in range(8):
        session.advance(0.15)
        x, y = (session.shown()["axes"][name]["position"] for name in "xy")
        assert np.hypot(x - 400, y - 250) == pytest.approx(40, abs=0.05)  # mm
    session.release()
    assert machine.drives["x"].read("following_error_window") == 1000
    assert session.move("x", 0.2) == session.move("y", 0.1) == ""


def test_a_policy_of_ones_own_file_moves_a_robot_of_ones_own(tmp_path):
    (tmp_path / "own.py").write_text(
        "def nudge(observation):\n    return [0.0, 0.5 if observation[0] < 2 else 0.0]\n"
    )
    machine = Machine.from_mjcf(ARM, dict.fromkeys(("shoulder", "elbow"), "generic"))
    for joint in machine.drives:
        commission_joint(machine, joint)
    machine.reset(positions={})
    session = Session(machine)
    for joint in session.axes:
        assert session.enable(joint) == session.home(joint, 37) == ""
    laboratory = Laboratory(lambda axis: robot(ARM, machine, axis))
    before = {name: session.shown()["axes"][name]["position"] for name in session.axes}
    session.hand_over(laboratory.agent(session, "elbow", f"{tmp_path}/own.py:nudge", 20))
    session.advance(0.2)
    session.release()
    after = {name: session.shown()["axes"][name]["position"] for name in session.axes}
    assert after["elbow"] > before["elbow"] + 2  # degrees
    assert after["shoulder"] == pytest.approx(before["shoulder"], abs=0.5)
    with pytest.raises(ValueError, match=r"goal 200 is out of range -130\.\.130 °"):
        laboratory.agent(session, "elbow", "hold", 200)


def test_each_axis_that_is_served_has_policies_or_the_reason_why_not():
    assert {*FITTING, *NONE} == {*AXES}
    for fitting in FITTING.values():
        assert set(fitting.names) <= {*fitting.task.POLICIES, "learned"}


def test_quick_stop_outranks_a_policy(homed):
    homed.hand_over(Laboratory().agent(homed, "x", "ruckig", 400))
    homed.advance(0.05)
    assert homed.quick_stop() == ""
    assert homed.agent is None
    assert homed.machine.drives["x"].state is State.SWITCH_ON_DISABLED


def test_side_by_side_leaves_the_machine_alone_and_judges_alike(homed):
    before = homed.machine.snapshot()
    ruckig, proportional = Laboratory().compare(homed.machine, "x", ["ruckig", "proportional"], 400)
    assert homed.machine.snapshot() == before
    assert ruckig.settling_time < proportional.settling_time
    assert ruckig.value[0] == pytest.approx(100, abs=1)  # mm
    assert ruckig.value[-1] == pytest.approx(400, abs=0.05)


@pytest.mark.parametrize(
    ("policy", "goal", "said"),
    [("nonsense", 300, "unknown"), ("built_in", 300, "LinearAxis|is for"), ("ruckig", 900, "goal")],
)
def test_a_policy_that_does_not_fit_is_refused_in_words(homed, policy, goal, said):
    with pytest.raises(ValueError, match=said):
        TakeOver(homed.machine, policy, goal)


def test_an_axis_beyond_the_stroke_is_not_handed_over(session):
    session.enable("x"), session.home("x", 17)  # ends 5 mm behind the software limit
    with pytest.raises(ValueError, match=r"stands at -4\.9\d mm.*move it there first"):
        TakeOver(session.machine, "ruckig", 300)


def test_an_axis_without_reference_is_not_handed_over(session):
    with pytest.raises(ValueError, match="home it first"):
        TakeOver(session.machine, "ruckig", 300)


# ---------------------------------------------------------------- parameters


def test_a_saved_parameter_set_brings_its_values_back(session):
    content = session.save_parameters("x")
    session.write("x", "max_torque", 1234)
    assert session.load_parameters("x", content) == ""
    assert session.machine.drives["x"].read("max_torque") == 3000


def test_a_parameter_set_that_cannot_be_trusted_is_refused_and_nothing_changes(session):
    content = session.save_parameters("x")
    session.write("x", "max_torque", 1234)
    altered = content.replace(b"3000", b"2999")
    other = json.dumps(json.loads(content) | {"model": "kollmorgen_akd"}).encode()
    for wrong in (altered, other, b"", b"{", b"\xff", content[:100]):
        assert session.load_parameters("x", wrong)
        assert session.machine.drives["x"].read("max_torque") == 1234
    session.enable("x")
    assert "disable" in session.load_parameters("x", content)


# ------------------------------------------------------------------ pictures


@pytest.mark.parametrize("make", [linear_axis, gantry, rotary_axis])
def test_the_scene_has_every_moving_body_and_its_poses(make):
    machine = make()
    session = Session(machine)
    session.advance(0.01)
    told = scene(machine)
    poses = Poses(machine).now()
    assert len(poses["now"]) == 7 * len(told["bodies"])
    assert np.isfinite(poses["now"]).all()
    assert {shape["body"] for shape in told["shapes"]} & set(told["bodies"])
    json.dumps([told, poses])
    for name in session.axes:
        assert session.shown()["axes"][name]["state"] == State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("method", NUMBERS)
def test_the_diagram_of_a_homing_method_ends_where_its_edge_is(method):
    edges = {0.0, 1.0, NEGATIVE, POSITIVE, 0.5, *HOME}
    for start in (0.25, 0.5, 0.75):
        path = homing_path(method, start)
        assert path[0] == start
        place = path[-1]
        on_index = abs(place * 24 - round(place * 24)) < 1e-9
        assert method in HERE or place in edges or on_index
    assert homing_svg(method).startswith("<svg")


def test_the_state_diagram_has_an_arrow_for_each_transition():
    pytest.importorskip("nicegui")
    from servogym.envs.panel.pages.state_diagram import ARROWS, PLACES

    assert set(ARROWS) == {row.number for row in transitions()}
    assert set(PLACES) == set(State)
