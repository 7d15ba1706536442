"""Several drives as one: squaring a bridge, and straight lines."""

import numpy as np
import pytest

from servogym.drive.canopen.nmt import NmtCommand
from servogym.drive.canopen.port import NodePort
from servogym.drive.canopen.remote import CanOpenPort
from servogym.drive.kernel.words import State
from servogym.drive.kernel.words import Statusword as S
from servogym.drive.master import DriveFault, Interlock, Master, Refused, Timeout, Units
from servogym.envs import gantry
from servogym.envs.masters.port import MachinePort
from servogym.envs.masters.squaring import square

SQUARE = 50e-6  # m, skew that squaring may leave
OVERRUN = 0.05**2 / (2 * 2.0)  # m, of a switch at the homing speed and deceleration


@pytest.fixture(scope="module")
def machine():
    return gantry(x_drives=2)


@pytest.mark.parametrize("seed", range(4))
def test_squaring_from_any_skew_ends_square_and_never_twists_the_bridge_further(machine, seed):
    skew = np.random.default_rng(seed).uniform(-2e-3, 2e-3)
    machine.reset(positions={"x1": 0.02, "x2": 0.02 + skew, "y": 0.1 * seed, "z": -0.1})
    machine.step(400)
    begin, seen = machine.skew, []
    assert begin == pytest.approx(skew, rel=0.1), "friction holds the bridge skew"
    left = square(machine, on_step=lambda: seen.append(machine.skew))
    assert abs(left) < SQUARE
    assert max(map(abs, seen)) < abs(begin) + OVERRUN
    assert machine.data.joint("x1").qpos[0] == pytest.approx(0.0, abs=0.4e-3)


@pytest.mark.parametrize("offset", [-2e-3, 1.5e-3])
@pytest.mark.parametrize("drive", ["generic", "kollmorgen_akd", "festo_cmmp_as"])
def test_switches_that_are_not_in_line_are_corrected_by_the_home_offset(drive, offset):
    machine = gantry(drive, x_drives=2, squaring_offset=offset)
    machine.reset(positions={"x1": 0.02, "x2": 0.02, "y": 0.25, "z": -0.1})
    assert abs(square(machine)) < SQUARE
    before = machine.drives["x1"].read("home_offset") - machine.drives["x2"].read("home_offset")
    assert before == round(offset * 1e6)


def test_the_home_switches_square_the_bridge_too():
    machine = gantry(x_drives=2, squaring_offset=1e-3)
    machine.reset(positions={"x1": 0.15, "x2": 0.1515, "y": 0.25, "z": -0.1})
    for name in ("x1", "x2"):
        machine.drives[name].write("homing_method", 20)
    assert abs(square(machine)) < SQUARE
    assert machine.data.joint("x1").qpos[0] == pytest.approx(0.205, abs=0.4e-3)


def test_a_side_that_misses_its_switch_stops_both_before_the_bridge_is_torn():
    machine = gantry(x_drives=2)
    machine.couplings["switch_to"][1][0] = -2.0  # x2's negative limit switch
    machine.reset(positions={"x1": 0.01, "x2": 0.01, "y": 0.25, "z": -0.1})
    with pytest.raises(Interlock, match=r"twisted by \d+\.\d mm; all drives were stopped"):
        square(machine, max_twist=0.004)
    machine.step(400)
    assert abs(machine.skew) < 0.004 + 2 * OVERRUN
    assert all(machine.drives[x].state != State.OPERATION_ENABLED for x in ("x1", "x2"))


def test_a_fault_of_one_drive_stops_the_other(machine):
    machine.reset(positions={"x1": 0.3, "x2": 0.3, "y": 0.25, "z": -0.1})
    pair = Master(MachinePort(machine), "x1", "x2")
    pair.enable()
    pair.port.on_step = lambda: machine.time > 0.3 and machine.drives["x2"].inject("encoder_loss")
    with pytest.raises(DriveFault, match=r"homing: FAULT, error code 73\w\wh .*; x2: ") as caught:
        pair.home()
    assert caught.value.axes == ("x2",)
    machine.drives["x2"].clear_injected()
    machine.step(400)
    assert machine.drives["x1"].state == State.SWITCH_ON_DISABLED
    assert abs(machine.data.joint("x1").qvel[0]) < 1e-3


def test_a_drive_that_does_not_come_is_named(machine):
    machine.reset(positions={"x1": 0.3, "x2": 0.3})
    machine.drives["x2"].axis.enable_input = 0
    try:
        with pytest.raises(Timeout, match=r"enable: not within 1 s; x2: "):
            Master(MachinePort(machine), "x1", "x2").enable(timeout=1.0)
    finally:
        machine.drives["x2"].axis.enable_input = 1


def line(machine, targets, profile=0):
    """A coordinated move; -> demands, positions (µm), bits 12, ends: shape ``(cycles, axes)``."""
    demands, positions, acknowledged, done = seen = [], [], [], []

    def look():
        demands.append([d.read("position_demand_value") for d in machine.drives.values()])
        positions.append([machine.data.joint(x).qpos[0] * 1e6 for x in targets])
        acknowledged.append([bool(word & S.MODE_12) for word in group.statusword.values()])
        done.append([bool(drive.axis.profile_done) for drive in machine.drives.values()])

    group = Master(MachinePort(machine, look))
    group.enable()
    for drive in machine.drives.values():
        drive.write("homing_method", 37 if drive.model.name == "generic" else 35)
        if "motion_profile_type" in drive.objects.names:
            drive.write("motion_profile_type", profile)
    group.home()
    machine.step(100)
    for part in seen:
        del part[:]
    group.move_to({name: target * 1e-6 for name, target in targets.items()}, timeout=60)
    return [np.array(part, float) for part in seen]


def off_line(path, begin, end):
    """Largest distance of the points of a path from the line through `begin` and `end`."""
    along = (end - begin) / np.linalg.norm(end - begin)
    away = path - begin
    return np.linalg.norm(away - np.outer(away @ along, along), axis=1).max()


@pytest.mark.parametrize(
    ("drive", "profile"), [("generic", 0), ("generic", 3), ("kollmorgen_akd", 0)]
)
@pytest.mark.parametrize("way", [(200_000, 50_000, -30_000), (10_000, -100_000, -150_000)])
def test_all_axes_start_in_one_sync_go_straight_and_arrive_together(drive, profile, way):
    machine = gantry(drive, x_drives=2)
    machine.reset(positions={"x1": 0.1, "x2": 0.1, "y": 0.25, "z": -0.1})
    x, y, z = way
    for name, end in zip(("x1", "x2", "y", "z"), (300_000,) * 4, strict=True):
        machine.drives[name].commission({"min_position_limit": -end, "max_position_limit": end})
    targets = {"x1": x, "x2": x, "y": y, "z": z}
    demands, positions, acknowledged, done = line(machine, targets, profile)
    end = np.array([*targets.values()], float)
    accepted = np.diff(acknowledged, axis=0) == 1
    assert accepted.any(axis=1).sum() == 1, "in one cycle"
    assert accepted.any(axis=0).all(), "by all"
    arrived = len(done) - np.argmin(done[::-1], axis=0)
    assert np.ptp(arrived) * machine.cycle_time <= 1e-3
    assert off_line(demands, demands[0], end) < 2.0
    assert off_line(positions, positions[0], positions[0] + end - demands[0]) < 100.0


def test_the_slowest_axis_sets_the_time_and_the_profiles_are_as_before():
    machine = gantry()
    machine.reset(positions={"x": 0.1, "y": 0.25, "z": -0.1})
    for drive in machine.drives.values():
        drive.commission({"min_position_limit": -300_000, "max_position_limit": 300_000})
    machine.drives["y"].write("profile_velocity", 50_000)
    demands, *_ = line(machine, {"x": 200_000, "y": 100_000, "z": -10_000})
    ways = np.abs([200_000, 100_000, -10_000] - demands[0])
    speed = np.abs(demands[100:] - demands[:-100]).max(axis=0) / (100 * machine.cycle_time)
    assert speed == pytest.approx(50_000 * ways / ways[1], rel=0.01)
    kept = [drive.read("profile_velocity") for drive in machine.drives.values()]
    assert kept == [500_000, 50_000, 500_000]


def test_what_cannot_be_coordinated_is_refused(machine):
    with pytest.raises(ValueError, match=r"axes = \['x'\]: choose some of the drives \['x1'"):
        Master(MachinePort(machine), "x")
    machine.reset()
    pair = Master(MachinePort(machine), "x1", "x2")
    pair.enable()
    with pytest.raises(Refused, match=r"move_to: \{'x1': 0\}; give one value for each of"):
        pair.move_to({"x1": 0})
    with pytest.raises(Refused, match="wait=False; on a straight line they are waited for"):
        pair.move_to(0.0, wait=False)
    with pytest.raises(ValueError, match=r"axes = \['x1', 'x2'\]"):
        square(gantry())
    with pytest.raises(ValueError, match=r"HOMING: drive 'bonfiglioli_act' of x1, x2 does not"):
        square(gantry("bonfiglioli_act", x_drives=2))
    with pytest.raises(ValueError, match="max_twist = 0"):
        square(machine, max_twist=0)


def two_nodes(pdo):
    """Both sides of a bridge as nodes of one bus, at place 0."""
    machine = gantry(x_drives=2)
    machine.reset(positions={"x1": 0.1, "x2": 0.1, "y": 0.25, "z": -0.1})
    port = CanOpenPort(NodePort(machine), {"x1": 1, "x2": 2}, units=Units(1e-6, 1e-6, "m"))
    if pdo:
        port.use_pdos()
    pair = Master(port)
    pair.enable()
    pair.write("home_offset", 0)
    pair.home({"x1": 37, "x2": 37})
    return machine, port, pair


@pytest.mark.parametrize("pdo", [False, True], ids=["sdo", "pdo"])
def test_two_drives_on_a_bus_go_straight_too(pdo):
    machine, _, pair = two_nodes(pdo)
    seen = []
    step = machine.step
    machine.step = lambda: (step(), seen.append(machine.skew))
    pair.move_to({"x1": 0.1, "x2": 0.1})
    for joint in ("x1", "x2"):
        assert machine.data.joint(joint).qpos[0] == pytest.approx(0.2, abs=1e-4)
    assert pair.position == pytest.approx({"x1": 0.1, "x2": 0.1}, abs=1e-4)
    assert pair["x2"].position == pytest.approx(0.1, abs=1e-4)
    assert max(map(abs, seen)) < (0.5e-3 if pdo else 5e-3), "by SDO one starts some cycles later"


def test_a_node_that_is_gone_stops_the_other():
    machine, port, pair = two_nodes(pdo=True)
    pair["x1"].jog(0.05)
    port.nodes["x2"].nmt(NmtCommand.STOP)
    with pytest.raises(Timeout, match=r"node 2, SDO request for 60\w\wh:00h: no answer"):
        pair.wait_until(lambda word: False, 5.0, "work")
    machine.step(2000)
    assert machine.drives["x1"].state == State.SWITCH_ON_DISABLED
    assert abs(machine.data.joint("x1").qvel[0]) < 1e-3
