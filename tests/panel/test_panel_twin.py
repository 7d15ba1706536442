"""A twin beside an axis: told what the drive is told; what differs is what the machine has more."""

import csv
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from browser import (
    Command,
    Server,
    at,
    expect,
    move,
    needs_chromium,
    open_page,
    picture,
    ready,
    shows,
    tab,
)

from servogym.drive.canopen.node import Node
from servogym.drive.canopen.port import NodePort
from servogym.drive.master import Units
from servogym.envs.panel import lessons
from servogym.envs.panel.bus import BusBench
from servogym.envs.panel.disturbances import DISTURBANCES, disturb, inject
from servogym.envs.panel.session import Session
from servogym.envs.plants import twins
from servogym.envs.plants.axis_parameters import family
from servogym.envs.plants.catalogue import fresh, power_on
from servogym.envs.plants.linear_axis import linear_axis
from servogym.training.policies.takeover import Laboratory

CHANNELS = (
    "position_actual_value", "twin:position_actual_value",
    "following_error_actual_value", "twin:following_error_actual_value",
)


def linear_axis_payload():
    return family("rigid").payload


def twin_of(**values):
    machine = linear_axis(**values)
    power_on(machine, {})
    return machine


def bench(**values):
    session = Session(fresh("linear"), "linear")
    session.put_beside(twin_of(**values))
    return session


def traces(session):
    """Position, that of the twin, following error, that of the twin (µm), in the last window."""
    return session.scope.view(10**6).values


def homed(session, axis="x", method=17):
    assert session.enable(axis) == ""
    assert session.home(axis, method) == ""
    session.advance(0.5)  # it stands, and so does the twin
    return session


def test_the_scope_shows_both_from_the_first_picture():
    session = bench()
    assert session.scope.channels == CHANNELS
    assert {*CHANNELS} <= {*session.channels()}
    session.advance(0.1)
    assert session.shown()["twin"] == "switch on disabled"
    here, beside, *_ = traces(session)
    assert np.isnan(beside[0])  # it looks whether the axis stands
    assert abs(here - beside)[-50:].max() <= 1
    assert [session.unit_of(name) for name in CHANNELS] == [
        session.unit_of(name.removeprefix("twin:")) for name in CHANNELS
    ]


@pytest.mark.parametrize("cycles", [1, 4])
def test_a_twin_of_the_same_machine_does_the_same(cycles):
    session = Session(fresh("linear"), "linear", cycles)
    session.put_beside(twin_of())
    homed(session)
    session.move("x", 0.1)  # what the controllers held against friction is forgotten
    session.scope.clear()
    session.move("x", 0.3)
    here, beside, error, twins_error = traces(session)
    assert np.ptp(here) > 100_000  # µm: it has moved
    assert abs(here - beside).max() <= 2
    assert abs(error - twins_error).max() <= 2
    assert session.shown()["twin"] == "operation enabled"


def test_friction_that_the_twin_does_not_have_shows_as_its_torque():
    """At constant speed the difference of torques is F p / (2 pi), here of 30 N."""
    session = homed(bench())
    friction = next(each for each in DISTURBANCES if each.part == "friction")
    was = friction.read(session, 0)
    assert disturb(session, "x", friction, was + 30.0) == ""
    session.jog("x", 0.05)
    session.advance(0.6)
    session.scope.choose(["axis.torque", "twin:torque_actual_value"])
    session.advance(0.4)
    torque, share = traces(session)[:, -500:].mean(axis=1)
    rated = session.beside.drive.read("motor_rated_torque") / 1000  # mNm
    gear, _ = session.machine.joint("x")
    assert torque - share / 1000 * rated == pytest.approx(30.0 / gear, rel=0.03)


def test_a_payload_that_the_twin_has_more_shows_as_its_torque():
    """At constant acceleration the difference of torques is m a p / (2 pi), here of 3 kg."""
    session = homed(bench(payload=linear_axis_payload() + 3.0))
    session.move("x", 0.02)
    for name in ("profile_acceleration", "profile_deceleration"):
        session.write("x", name, 1_000_000)  # µm/s²
    session.write("x", "motion_profile_type", 0)  # trapezoidal
    session.scope.choose(["velocity_actual_value", "axis.torque", "twin:torque_actual_value"])
    session.move("x", 0.3)
    speed, torque, share = traces(session)
    steady = (speed > 100_000) & (speed < 300_000) & (np.gradient(speed) > 0)
    assert steady.sum() > 200
    rated = session.beside.drive.read("motor_rated_torque") / 1000  # mNm
    gear, _ = session.machine.joint("x")
    more = (share[steady] / 1000 * rated - torque[steady]).mean()
    assert more == pytest.approx(3.0 * 1.0 / gear, rel=0.05)


def test_a_fault_that_is_injected_stays_with_the_machine():
    session = homed(bench())
    inject(session, "x", "overvoltage")
    session.advance(0.1)
    assert session.machine.drives["x"].fault
    assert session.shown()["twin"] == "operation enabled"
    session.machine.drives["x"].clear_injected()
    session.reset_fault("x")
    session.enable("x")
    session.beside.due = True
    session.advance(0.1)
    assert session.shown()["twin"] == "operation enabled"


def test_a_policy_moves_both():
    session = homed(bench())
    session.move("x", 0.1)
    session.hand_over(Laboratory().agent(session, "x", "trapezoid", 300.0))
    session.advance(1.0)
    session.release()
    here, beside, *_ = traces(session)
    assert here[-1] == pytest.approx(300_000, abs=200)
    assert beside[-1] == pytest.approx(300_000, abs=200)


def test_where_the_machine_is_put_the_twin_stands():
    session = homed(bench())
    session.move("x", 0.2)
    session.keep("here")
    session.move("x", 0.4)
    for put in (lambda: session.back("here"), session.reset,
                lambda: lessons.leave(session)):
        put()
        session.advance(0.1)
        here, beside = (session.reader(name)() for name in CHANNELS[:2])
        assert beside == pytest.approx(here, abs=5)  # both within their window
    assert session.shown()["twin"] == "switch on disabled"


def test_what_the_twin_refuses_stands_in_the_log_and_the_axis_goes_on():
    session = Session(fresh("linear"), "linear")
    before = session.scope.channels
    session.put_beside(twin_of(drive="bonfiglioli_act"))  # a frequency inverter: no position
    assert session.scope.channels == before
    session.advance(0.1)
    for _ in range(3):
        assert session.command("x", "target_position", 1000) == ""
    said = [each.text for each in session.log.events if "twin: target_position" in each.text]
    assert len(said) == 1
    assert session.enable("x") == ""


def test_a_twin_that_turns_is_refused_beside_an_axis_that_slides():
    session = Session(fresh("linear"), "linear")
    with pytest.raises(ValueError, match="in rad, axis x in m"):
        session.put_beside(fresh("rotary-table"))
    with pytest.raises(ValueError, match="there is no axis 'z'"):
        session.put_beside(twin_of(), "z")


@pytest.mark.parametrize("units", [Units(1e-6, 1e-6, "m"), None])
def test_a_node_on_a_bus_has_its_twin_in_the_scope(units):
    machine = linear_axis()
    machine.reset(positions={"x": 0.12})
    drive = machine.drives["x"]
    drive.node_id = 5
    drive.reset_communication()
    node = BusBench(NodePort(machine, Node(drive)), {"node 5": 5}, rate=100, units=units)
    node.put_beside(twin_of())
    node.advance(1.0)
    assert node.shown()["twin"] == "switch on disabled"
    homed(node, "node 5", 37)
    node.advance(0.6)
    assert node.shown()["twin"] == "operation enabled"
    unit = 1.0 if units is None else 1e-6
    assert node.move("node 5", 50_000 * unit) == ""
    node.advance(0.3)
    here, beside, *_ = traces(node)
    assert here[-1] == pytest.approx(50_000, abs=30)
    assert beside[-1] == pytest.approx(50_000, abs=30)
    ends = here[~np.isnan(beside)], beside[~np.isnan(beside)]
    assert np.abs(np.subtract(*ends)).max() < 0.02 * 400_000  # a request late at 0.4 m/s
    assert not math.isnan(beside[-1])


@pytest.fixture
def folder(tmp_path):
    """A twin with 2 kg more than the axis, as `servogym twin` writes one."""
    content = {
        "schema": twins.SCHEMA, "drive": "generic", "verdict": "good", "cycle": 0.002, "lag": 0.0,
        "machine": {"builder": "linear_axis", "arguments": {"mechanics": "rigid"}, "axis": "x"},
        "parameters": {"payload": {
            "value": linear_axis_payload() + 2.0, "low": 2.0, "high": 2.1, "unit": "kg",
        }},
        "objects": {}, "held_out": {},
    }
    content["checksum"] = twins.checksum(content)
    (tmp_path / twins.FILE).write_text(json.dumps(content))
    return tmp_path


@pytest.mark.parametrize(
    ("options", "said"),
    [("--twin {}/none", "no such file"), ("--axis gantry-x1x2 --twin {}", "of axis 'x'"),
     ("--axis rotary-table --twin {}", "in m, axis x in rad")],
)
def test_a_twin_that_does_not_fit_is_refused(options, said, folder, refused):
    assert said in refused(["panel", "--no-browser", *options.format(folder).split()])


class TestInTheBrowser:
    """The command as it is typed."""

    pytestmark = needs_chromium

    def test_the_twin_is_beside_the_axis_and_can_be_aligned(self, browser, folder):
        server = Server("--twin", str(folder), "--pictures", "4")
        try:
            page = tab(browser, server)
            ready(page)
            move(page, "100")
            open_page(page, "scope")
            shows(page, "twin-state", "operation enabled")
            at(page, "align-twin").click()
            shows(page, "twin-state", "operation enabled")
            for name in CHANNELS:
                expect(at(page, "page-scope")).to_contain_text(name)
            picture(page, "twin")
        finally:
            server.kill()

    @pytest.mark.slow
    def test_beside_a_node_the_scope_has_the_positions_of_the_nodes_own_log(
        self, browser, folder, tmp_path
    ):
        """Each sample of the node is a value that the node has logged as sent."""
        bus = ("-i", "udp_multicast", "-c", "239.74.163.47", "--bus-kwargs", "port=43147")
        log = tmp_path / "node.log"
        node = Command("node", "--node-id", "5", "--log", str(log), *bus, until="as node 5 on")
        server = Server("--node-id", "5", "--units", "1e-6", "--twin", str(folder), "--samples",
                        "100", "--pictures", "4", *bus)
        try:
            page = tab(browser, server)
            open_page(page, "motion")
            at(page, "enable").click()
            shows(page, "state", "operation enabled")
            at(page, "home").click()
            expect(at(page, "position")).to_have_text(re.compile(r"^−4\.9"))
            shows(page, "doing", "")
            at(page, "set-profile_velocity").fill("50000")  # µm/s
            at(page, "set-profile_velocity").press("Enter")
            shows(page, "value-profile_velocity", "50000")
            open_page(page, "scope")
            at(page, "window").fill("8")
            at(page, "window").press("Enter")
            shows(page, "twin-state", "operation enabled")
            open_page(page, "motion")
            move(page, "100")
            expect(at(page, "position")).to_have_text(re.compile(r"^(99\.9|100\.0)\d\d$"))
            shows(page, "doing", "")
            open_page(page, "scope")
            with page.expect_download() as download:
                at(page, "csv").click()
            rows = csv.DictReader(Path(download.value.path()).read_text().splitlines())
            samples = [(float(row["position_actual_value (mm)"]),
                        float(row["twin:position_actual_value (mm)"])) for row in rows]
        finally:
            server.kill()
            node.end()
        sent = re.findall(r" 585#43646000(\w{8})", log.read_text())
        known = {int.from_bytes(bytes.fromhex(each), "little", signed=True) for each in sent}
        here, beside = np.array([each for each in samples if not np.isnan(each).any()]).T
        assert {round(1000 * each) for each in here} <= known
        begin = np.flatnonzero(here < -4.0)[-1]  # homed; the twin stands where the axis stands
        here, beside = here[begin:], beside[begin:]
        assert np.ptp(here) > 100.0  # mm: the whole move
        assert abs(here - beside).max() < 50 * 0.1  # at 50 mm/s, an answer that is 0.1 s late
        assert abs(here - beside)[-10:].max() < 0.05
