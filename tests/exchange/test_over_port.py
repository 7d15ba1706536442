"""A task on a port: the same bytes as in memory, and a guard that no policy gets past."""

import copy
import itertools
import math
import shutil
import threading
import time
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from servogym import assets
from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.node import Node
from servogym.drive.canopen.remote import CanOpenPort
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.port import EtherCatPort
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.kernel.words import State
from servogym.drive.master import ServoError
from servogym.drive.model.model import load
from servogym.drive.objects.abort import SdoAbort
from servogym.envs import TASKS
from servogym.envs.environment.deployed import in_memory, play
from servogym.envs.exchange.envelope import Envelope, Stopped
from servogym.envs.exchange.over_port import CanDrives, EtherCatDrives, LockStep
from servogym.envs.masters.homing_figures import true_home
from servogym.envs.serve import in_process
from servogym.training.policies import make

NAMES = {task.ID: task for task in TASKS}
LINEAR, TRACKING, CONTOUR, HOMING = (
    "servogym/LinearAxis-v0", "servogym/LinearAxisTracking-v0", "servogym/GantryContour-v0",
    "servogym/Homing-v0",
)
ENDLESS = 200.0  # s
DRIVE = {"can": "generic", "ethercat": load("generic", "ethercat")}


class Served(LockStep):
    """The drives of another environment, in lock-step: time passes where the line waits, or always.

    Args:
        task: id.
        seed: of its reset, after which the drives stand where an episode begins.
    """

    def __init__(self, task, seed, **arguments):
        self.env = NAMES[task](**arguments)
        self.env.reset(seed=seed)
        self.machine = self.env.machine
        self.drives = self.env.drives
        self.passes = False  # time, with every exchange
        self.time = 0.0
        self.dead = False
        self.before = lambda: None

    def now(self):
        return self.time

    def wait(self, deadline):
        cycles = round((deadline - self.time) / self.machine.cycle_time)
        if cycles > 0:
            self._pass(cycles)

    def _pass(self, cycles):
        self.machine.step(cycles)
        self.time += cycles * self.machine.cycle_time


class CanBus(Served):
    """Its drives as nodes; the port of a master on their bus."""

    def __init__(self, *arguments, **others):
        super().__init__(*arguments, **others)
        self.nodes = [Node(drive) for drive in self.drives]
        self.others = []  # frames of other nodes, with every exchange of drives that are dead
        self._poll()

    def _poll(self):
        return [f for node in self.nodes for f in node.poll(round(self.time * 1e6))]

    def passed_alone(self):
        """A cycle in which nobody says anything."""
        self._pass(1)
        self._poll()

    def exchange(self, frames):
        if self.dead:
            self.time += 1e-3
            assert self.time < ENDLESS
            return self.others
        for frame in frames:
            for node in self.nodes:
                node.receive(frame, round(self.time * 1e6))
        answers = self._poll()
        if self.passes:
            self._pass(1)
            answers += self._poll()
        return answers

    def side(self, **arguments):
        names = {n: d.node_id for n, d in zip(axes(self.env), self.drives, strict=True)}
        return CanDrives(self, names, pace=self, **arguments)


class EtherCatBus(Served):
    """Its drives as slaves on a segment in memory; the wire of a master."""

    def __init__(self, *arguments, **others):
        super().__init__(*arguments, **others)
        self.segment = Segment([Slave(drive) for drive in self.drives])
        self.bus = Bus(self.segment)

    def passed_alone(self):
        self._pass(1)

    def _pass(self, cycles):
        super()._pass(cycles)
        self.bus.let_pass(round(cycles * self.machine.cycle_time * 1e9))

    def exchange(self, frame, now=0):
        if self.dead:
            self._pass(1)
            return None
        if self.passes:
            self._pass(1)
        self.segment.publish(self.bus.time)
        return self.bus.exchange(frame, now)

    def __getattr__(self, name):
        return getattr(self.__dict__["bus"], name)

    def side(self, **arguments):
        master = EtherCatMaster(self)
        return EtherCatDrives(master, axes(self.env), DRIVE["ethercat"], pace=self, **arguments)


def axes(env):
    return [*(env.DRIVES or env.machine.drives)]


QUICK = "quick_stop_deceleration"
BUSES = {"can": CanBus, "ethercat": EtherCatBus}


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("task", [LINEAR, TRACKING, CONTOUR, HOMING])
@pytest.mark.parametrize("acting", ["at random", "by its reference"])
def test_in_lock_step_an_episode_is_the_one_in_memory_byte_by_byte(bus, task, acting):
    drive = {"drive": DRIVE[bus]}
    served, plain = BUSES[bus](task, 5, **drive), NAMES[task](**drive)
    side = served.side(envelopes=wide(plain))
    env = gym.make(task, port=side, disable_env_checker=True, **drive)
    at_the_start(served, env.unwrapped.line)
    observation, _ = env.reset(seed=5)
    expected, told = plain.reset(seed=5)
    plain.action_space.seed(2)
    policy = make(plain.REFERENCE, plain, 5)
    policy.reset(expected, told)
    for _ in range(60 if acting == "at random" else plain.STEPS):  # set-points come to rest
        assert observation.tobytes() == expected.tobytes()
        random = acting == "at random"
        action = 0.2 * plain.action_space.sample() if random else policy.act(expected)
        observation, reward, ended, *_ = env.step(action)
        expected, wanted, over, *_ = plain.step(action)
        assert ended == over
        if ended:
            break
        if task not in (CONTOUR, HOMING):  # made of the true place of the tool, of the switch
            assert reward == wanted
    assert env.unwrapped.line.lost == 0
    served.passes = True
    env.close()
    assert all(drive.state is not State.OPERATION_ENABLED for drive in served.drives)


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("reference", ["home_switch", "negative_limit_switch", "stop"])
def test_an_episode_of_homing_begins_enabled_without_a_reference_and_tells_the_error(
    bus, reference, monkeypatch
):
    machines, made = [], in_process.made
    given = {"reference": reference}
    monkeypatch.setattr(in_process, "made", lambda *of: machines.append(made(*of)) or machines[-1])
    env = in_process.environment(HOMING, bus, parameters=given)
    (machine, _), = machines
    drive, axis, coupling = machine.drives["x"], machine.axes[0], machine.couplings[0]
    before = {name: drive.read(name) for name in ("homing_method", "max_torque")}
    home = true_home(machine, env.homing_method)
    for seed, start in ((5, 0.1), (6, 0.4)):
        seen, info = env.reset(seed=seed, options={"start": start})
        assert drive.state is State.OPERATION_ENABLED
        assert not axis.homed
        assert machine.data.qpos[coupling.qpos] == pytest.approx(info["start"], abs=20e-6)
        assert info["start"] == pytest.approx(start, abs=1e-3)
        policy, ended = make("search", env, seed), False
        policy.reset(seen, info)
        while not ended:
            seen, _, ended, _, info = env.step(policy.act(seen))
        assert info["attained"]
        assert env.declared()
        found = (axis.zero_counts * axis.rad_per_increment - axis.home_offset) / coupling.gear
        assert info["error"] == pytest.approx(found - home, abs=20e-6)
        assert 0.0 < info["greatest_torque"] <= 1.0
    env.close()
    assert drive.state is not State.OPERATION_ENABLED
    assert before == {name: drive.read(name) for name in before}, "as it was found"


def test_a_drive_that_cannot_find_the_true_home_is_refused_before_power():
    env = in_process.environment(HOMING, "can")
    model = env.line._side.port.models["x"]
    others = tuple(number for number in model.homing_methods if number != 23)
    env.line._side.port.models["x"] = replace(model, homing_methods=others)
    with pytest.raises(ValueError, match="does not have the homing method 23"):
        env.reset(seed=5)
    assert env.line.master.state is not State.OPERATION_ENABLED


@pytest.mark.parametrize(
    ("rpdo", "said"),
    [
        (("target_position", "position_offset"), "position_offset, which the guard does not check"),
        (("target_velocity", "velocity_offset"), "velocity_offset, which the guard does not check"),
        (("target_position", "profile_velocity"), "profile_velocity, which the guard does not"),
        (("target_position", "target_velocity"), "the guard follows one of them"),
    ],
)
def test_a_set_point_the_guard_does_not_look_at_is_refused(rpdo, said):
    served = CanBus(LINEAR, 5)
    with pytest.raises(ValueError, match=said):
        type("Own", (NAMES[LINEAR],), {"RPDO": property(lambda self: rpdo, lambda self, it: None)})(
            port=served.side()
        )


def alternating(k, space):
    return (space.high if k % 2 else space.low).copy()


def at(when, bad):
    return lambda k, space: bad(space) if k == when else np.zeros(space.shape, np.float32)


def raising(kind):
    def act(k, space):
        if k == 3:
            raise kind("of its own")
        return np.zeros(space.shape, np.float32)

    return act


HOSTILE = {  # policy: what the guard, or the environment, says of it
    "runs to the end": (lambda k, space: space.high, "out of 0.05..0.45|velocity"),
    "runs to the other end": (lambda k, space: space.low, "out of 0.05..0.45|velocity"),
    "creeps to the end": (lambda k, space: 0.2 * space.high, "out of 0.05..0.45"),
    "chatters": (alternating, "acceleration"),
    "steps once": (at(5, lambda space: space.high), "acceleration"),
    "NaN": (at(4, lambda space: np.full(space.shape, np.nan)), "nan"),
    "infinite": (at(4, lambda space: np.full(space.shape, np.inf)), "inf"),
    "wrong shape": (at(4, lambda space: np.zeros(7)), "not in Box"),
    "words": (at(4, lambda space: ["fast"]), "is no number"),
    "nothing": (at(4, lambda space: None), "is no number"),
    "beyond 1": (at(4, lambda space: 1.5 * space.high), "not in Box"),
    "raises": (raising(ValueError), "of its own"),
    "exits": (raising(SystemExit), "of its own"),
    "interrupts": (raising(KeyboardInterrupt), "of its own"),
    "runs out of memory": (raising(MemoryError), "of its own"),
    "never answers": (at(4, lambda space: threading.Event().wait(5.0)), "late"),
    "sleeps": (lambda k, space: time.sleep(0.2 * (k > 4)) or 0.0 * space.high, "late"),
}


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("name", HOSTILE)
def test_no_policy_gets_past_the_guard(bus, name):
    policy, said = HOSTILE[name]
    served = BUSES[bus](LINEAR, 5, drive=DRIVE[bus])
    acceleration = 5.0 if name in ("chatters", "steps once") else math.inf
    fast = 0.6 if name.startswith(("runs to the", "creeps")) else 3.0
    envelope = Envelope(0.05, 0.45, fast, acceleration, following_error=0.02)
    env = gym.make(LINEAR, drive=DRIVE[bus], port=served.side(envelopes={"x": envelope})).unwrapped
    served.passes = True
    steps = itertools.count()
    with pytest.raises(Stopped, match=said):
        play(env, lambda seen: policy(next(steps), env.action_space), 3, patience=0.05, seed=5)
    assert served.drives[0].state is not State.OPERATION_ENABLED
    stopping = fast * env.step_time + fast**2 / 2e-6 / served.drives[0].read(QUICK)
    assert 0.05 - stopping <= served.machine.data.qpos[0] <= 0.45 + stopping
    served.machine.step(200)
    assert abs(served.machine.data.qvel[0]) < 1e-3, "it stands"
    with pytest.raises(Stopped, match=said):
        env.step(0.0 * env.action_space.high)


@pytest.mark.parametrize("word", [0x0F, 0x1F, 0x3F, 0x010F])
def test_whatever_else_a_controlword_asks_for_its_set_point_is_guarded(word):
    served = CanBus(LINEAR, 5)
    side = served.side(envelopes={"x": Envelope(0.05, 0.45, 3.0)})
    line = gym.make(LINEAR, port=side).unwrapped.line
    image = np.zeros(1, line._rpdo)
    image["controlword"], image["target_position"] = word, 900_000
    with pytest.raises(Stopped, match=r"out of 0\.05\.\.0\.45"):
        line._command(image)


@pytest.mark.parametrize("bus", BUSES)
def test_an_environment_in_which_no_episode_has_begun_is_closed_at_once(bus):
    """Its drives have no time yet; a quick stop would wait for them."""
    env = in_process.environment(LINEAR, bus)
    drive = env.drive
    changed = [*env.line.settings.changed]
    env.close()
    assert changed
    assert not env.line.settings.changed
    assert drive.state is not State.OPERATION_ENABLED


def test_time_limits_end_while_syncs_are_held_back():
    line = in_process.environment(LINEAR, "can").line
    with pytest.raises(ServoError, match=r"not within 0\.1 s"):
        line.master.quick_stop(timeout=0.1)


@pytest.mark.parametrize(("step_time", "missed"), [(5e-3, 3), (2e-3, 5)])
@pytest.mark.parametrize("bus", BUSES)
def test_a_lost_link_stops_with_its_name(bus, step_time, missed):
    served = BUSES[bus](LINEAR, 5, drive=DRIVE[bus])
    env = gym.make(LINEAR, drive=DRIVE[bus], port=served.side(), step_time=step_time).unwrapped
    served.passes = True
    env.reset(seed=5)
    for _ in range(5):
        env.step(np.zeros(1))
    served.dead = True
    for _ in range(missed - 1):
        env.step(np.zeros(1))
    with pytest.raises(Stopped, match=f"^{missed} answers have not come"):
        env.step(np.zeros(1))
    for _ in range(400):  # nobody is there any more: the drive's own watchdog
        served.passed_alone()
    assert served.drives[0].state is not State.OPERATION_ENABLED


@pytest.mark.parametrize("playing", [False, True])
def test_in_lock_step_a_drive_that_falls_silent_is_given_up_though_others_talk(playing):
    served = CanBus(LINEAR, 5)
    env = gym.make(LINEAR, port=served.side()).unwrapped
    served.passes = True
    served.others = [Frame(0x702, b"\x05"), Frame(0x282, bytes(8))]  # heartbeat and PDO

    def go_on():
        if not playing:
            env.reset(seed=5)
        for _ in range(10):
            env.step(np.zeros(1))

    if playing:
        env.reset(seed=5)
    served.dead = True
    with pytest.raises((Stopped, ServoError)):
        go_on()


def test_a_fault_stops_with_its_name():
    served = CanBus(LINEAR, 5)
    env = gym.make(LINEAR, port=served.side()).unwrapped
    served.passes = True
    env.reset(seed=5)
    served.drives[0].inject("encoder_loss")
    with pytest.raises(Stopped, match="x: the drive is in a fault"):
        env.step(np.zeros(1))


def off(bus, change=lambda table: table, folder=None):
    """A served axis without power; `change` makes the objects of its own model in a folder."""
    model = DRIVE[bus]
    if folder:
        folder = shutil.copytree(Path(assets.__file__).parent / "drives/generic", folder / "other")
        table = folder / "objects.csv"
        table.write_text(change(table.read_text()))
        model = load(folder, bus)
    served = BUSES[bus](LINEAR, 5, drive=model)
    served.drives[0].write("controlword", 0)
    served.machine.step(10)
    return served


def refused(served, bus, error, said, **arguments):
    """Before there is power, in one line."""
    with pytest.raises(error, match=said) as raised:
        gym.make(LINEAR, drive=DRIVE[bus], port=served.side(**arguments))
    assert "\n" not in str(raised.value)
    assert served.drives[0].state is not State.OPERATION_ENABLED


@pytest.mark.parametrize("bus", BUSES)
def test_a_drive_that_is_not_the_model_is_refused_before_power(bus, tmp_path):
    served = off(bus, lambda table: table.replace("0x00000402", "0x00000777"), tmp_path)
    said = "x: product_code is 0x777, of model 'generic' it is .* give the model of the drive"
    refused(served, bus, ValueError, said)


@pytest.mark.parametrize("bus", BUSES)
@pytest.mark.parametrize("limits", [(-(2**31), 2**31 - 1), (-(2**31), 500_000), (0, 0)])
def test_a_drive_without_position_limits_is_refused_before_power_or_given_some(bus, limits):
    served = off(bus)
    served.drives[0].write("min_position_limit", limits[0])
    served.drives[0].write("max_position_limit", limits[1])
    said = "x: positions .* limit nothing: set the software position limits of the drive .607Dh"
    refused(served, bus, ValueError, said)
    side = served.side(envelopes={"x": {"low": 0.1, "high": 0.4}})
    env = gym.make(LINEAR, drive=DRIVE[bus], port=side).unwrapped
    assert env.line.guards["x"].envelope.high == 0.4
    served.passes = True
    env.close()


@pytest.mark.parametrize("bus", BUSES)
def test_the_least_of_607fh_and_6080h_limits_the_velocity_and_none_is_refused(bus, monkeypatch):
    served = off(bus)
    served.drives[0].write("max_motor_speed", 600)
    env = gym.make(LINEAR, drive=DRIVE[bus], port=served.side()).unwrapped
    way = math.tau / served.machine.couplings[0].gear  # m a revolution
    assert env.line.guards["x"].envelope.velocity == pytest.approx(10.0 * way)
    served.passes = True
    env.close()
    served, port = off(bus), {"can": CanOpenPort, "ethercat": EtherCatPort}[bus]
    upload = port.upload

    def without(self, axis, name):
        if name in ("max_profile_velocity", "max_motor_speed"):
            raise SdoAbort(0x0602_0000, 0x607F, 0)
        return upload(self, axis, name)

    monkeypatch.setattr(port, "upload", without)
    said = "x: velocity inf limits nothing: .* or give a maximum velocity"
    refused(served, bus, ValueError, said)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"faults": {"encoder_loss": 0.1}}, "port: faults and action='pdo'"),
        ({"action": "pdo"}, "port: faults and action='pdo'"),
    ],
)
def test_what_a_bus_cannot_do_is_said(arguments, said):
    served = CanBus(LINEAR, 5)
    with pytest.raises(ValueError, match=said):
        gym.make(LINEAR, port=served.side(), **arguments)
    with pytest.raises(ValueError, match="port: drives on a bus belong to one environment"):
        gym.make_vec(LINEAR, 2, port=served.side())
    env = gym.make(LINEAR, port=served.side())
    with pytest.raises(TypeError, match="cannot be copied"):
        copy.deepcopy(env)


@pytest.mark.parametrize("task", [t.ID for t in TASKS])
def test_each_task_begins_on_a_bus_or_says_why_not(task):
    served = CanBus(task, 5)
    if why := NAMES[task].MEMORY_ONLY:
        with pytest.raises(ValueError, match="runs in memory alone") as raised:
            gym.make(task, port=served.side())
        assert why in str(raised.value)
        return
    plain = NAMES[task]()
    env = gym.make(task, port=served.side(envelopes=wide(plain))).unwrapped
    at_the_start(served, env.line)
    seen, _ = env.reset(seed=5)
    assert seen.tobytes() == plain.reset(seed=5)[0].tobytes()
    served.passes = True
    env.close()


@pytest.mark.parametrize("bus", BUSES)
def test_an_axis_that_is_not_referenced_is_refused_before_power(bus):
    served = off(bus)
    served.machine.reset(positions={"x": 0.2})
    env = gym.make(LINEAR, drive=DRIVE[bus], port=served.side()).unwrapped
    served.passes = True
    with pytest.raises(ValueError, match="x is not referenced: home it with --home METHOD"):
        env.reset(seed=5)
    assert served.drives[0].state is not State.OPERATION_ENABLED


def test_a_drive_that_waits_for_another_sync_is_refused_before_power():
    served = off("can")
    served.drives[0].write(0x1005, 0x81)
    env = gym.make(LINEAR, port=served.side()).unwrapped
    served.passes = True
    said = r"no process data come back; x waits for the SYNC 81h \(1005h\): set it to 80h"
    with pytest.raises(Stopped, match=said):
        env.reset(seed=5)
    assert served.drives[0].state is not State.OPERATION_ENABLED


def test_a_slave_that_does_not_answer_is_refused_before_power():
    served = off("ethercat")
    env = gym.make(LINEAR, drive=DRIVE["ethercat"], port=served.side()).unwrapped
    served.dead = True
    with pytest.raises(Stopped, match="no reply to 3 frames; is the cable broken"):
        play(env, lambda seen: env.action_space.low, seed=5)
    assert served.drives[0].state is not State.OPERATION_ENABLED


def at_the_start(served, line):
    """The way to the start takes time; the drives are then what they were before it."""
    place, snapshot = line.place, served.machine.snapshot()

    def placed(*arguments):
        served.passes = True
        here = place(*arguments)
        served.machine.restore(snapshot)
        served.passes = False
        return here

    line.place = placed


def wide(env):
    return dict.fromkeys(axes(env), Envelope(-20.0, 20.0, 100.0))


class _Leaps:
    """A policy that the guard stops."""

    def reset(self, observation, info):
        pass

    def act(self, observation):
        return np.ones(1)


def test_a_policy_that_the_guard_stops_in_memory_says_so():
    slow = {"x": {"acceleration": 1e-3}}
    env = in_process.environment("LinearAxis-v0", "can", envelopes=slow)
    values, stopped = in_memory(env, _Leaps(), 2, seed=1)
    env.close()
    assert values == []
    assert "acceleration" in stopped
