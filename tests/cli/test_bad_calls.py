"""Wrong calls from Python: each is refused by us, in words that name what was given."""

import traceback
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import servogym.envs
from servogym.drive.drive import Drive
from servogym.drive.master import Master
from servogym.drive.model.model import load
from servogym.drive.objects.abort import SdoAbort
from servogym.envs import (
    FAMILY,
    LinearAxisParameters,
    Machine,
    RotaryParameters,
    ServoEnv,
    bode,
    commission_joint,
    gantry,
    linear_axis,
    register,
    rotary_axis,
    task,
    tune,
)
from servogym.envs.engine.checks import words
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.masters.port import MachinePort
from servogym.envs.tasks.contour import GantryContourEnv
from servogym.envs.tasks.homing import HomingEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.tasks.robot import RobotEnv
from servogym.envs.tasks.sway import GantrySwayEnv
from servogym.envs.tasks.tracking import LinearAxisTrackingEnv
from servogym.training.evaluate.episodes import Evaluator
from servogym.training.policies import make

HOUSE = tuple(str(Path(next(iter(part.__path__)))) for part in [servogym.envs]) + tuple(
    str(Path(next(iter(servogym.envs.__path__))).with_name(name)) for name in ("drive", "training")
)


@pytest.fixture(scope="module")
def env():
    env = LinearAxisEnv()
    env.reset(seed=0)
    return env


@pytest.fixture(scope="module")
def x():
    """A machine whose drive is enabled and referenced."""
    machine = linear_axis()
    machine.reset(positions={"x": 0.1})
    master = Master(MachinePort(machine), "x")
    master.enable()
    machine.drives["x"].write("homing_method", 37)
    master.home()
    return machine, master


NAN = float("nan")
ROBOT = """<mujoco><worldbody><body><joint name="elbow" type="hinge"/><geom size="0.1"/></body>
</worldbody></mujoco>"""
CALLS = {
    # environments
    "drive None": lambda s: LinearAxisEnv(drive=None),
    "drive number": lambda s: LinearAxisEnv(drive=3),
    "drive unknown": lambda s: LinearAxisEnv(drive="kolmorgen_akd"),
    "drive without mode": lambda s: LinearAxisEnv(drive="festo_cmms"),
    "argument unknown": lambda s: LinearAxisEnv(paylod=3),
    "argument gone": lambda s: LinearAxisEnv(cycles_per_step=10),
    "payload text": lambda s: LinearAxisEnv(payload="heavy"),
    "payload None": lambda s: LinearAxisEnv(payload=None),
    "payload nan": lambda s: LinearAxisEnv(payload=NAN),
    "payload array": lambda s: LinearAxisEnv(payload=[1, 2]),
    "parameters dict": lambda s: LinearAxisEnv(parameters={}),
    "parameters list": lambda s: LinearAxisEnv(parameters=[1]),
    "parameters unknown": lambda s: LinearAxisEnv(parameters="ball_scrow"),
    "parameters of another machine": lambda s: LinearAxisEnv(parameters=RotaryParameters()),
    "randomise list": lambda s: LinearAxisEnv(randomise=["payload"]),
    "randomise text": lambda s: LinearAxisEnv(randomise="payload"),
    "randomise unknown": lambda s: LinearAxisEnv(randomise={"paylod": 1}),
    "randomise range": lambda s: LinearAxisEnv(randomise={"payload": (3, 1)}),
    "randomise three": lambda s: LinearAxisEnv(randomise={"payload": (1, 2, 3)}),
    "randomise None": lambda s: LinearAxisEnv(randomise={"payload": None}),
    "randomise delay": lambda s: LinearAxisEnv(randomise={"delay": 99}),
    "randomise no spring": lambda s: LinearAxisEnv(randomise={"stiffness": 2}),
    "faults list": lambda s: LinearAxisEnv(faults=["encoder_loss"]),
    "faults unknown": lambda s: LinearAxisEnv(faults={"encoder_los": 0.1}),
    "faults drive": lambda s: LinearAxisEnv(faults={"y.encoder_loss": 0.1}),
    "faults probability": lambda s: LinearAxisEnv(faults={"encoder_loss": 2}),
    "faults text": lambda s: LinearAxisEnv(faults={"encoder_loss": "often"}),
    "mode": lambda s: LinearAxisEnv(mode="pp"),
    "mode list": lambda s: LinearAxisEnv(mode=["csp"]),
    "action": lambda s: LinearAxisEnv(action="torque"),
    "action list": lambda s: LinearAxisEnv(action=["pdo"]),
    "history": lambda s: LinearAxisEnv(history=0),
    "history text": lambda s: LinearAxisEnv(history="long"),
    "step_time": lambda s: LinearAxisEnv(step_time=0.0033),
    "step_time text": lambda s: LinearAxisEnv(step_time="5 ms"),
    "step_time negative": lambda s: LinearAxisEnv(step_time=-1),
    "render_mode": lambda s: LinearAxisEnv(render_mode="ansi"),
    "tolerance": lambda s: LinearAxisEnv(tolerance=0),
    "contour": lambda s: GantryContourEnv(contour="circel"),
    "sway axes": lambda s: GantrySwayEnv(axes="z"),
    "sway axes list": lambda s: GantrySwayEnv(axes=["x"]),
    "homing reference": lambda s: HomingEnv(reference="moon"),
    "tracking reference": lambda s: LinearAxisTrackingEnv(reference="spirl"),
    "tracking reference number": lambda s: LinearAxisTrackingEnv(reference=4),
    # the episode
    "step too wide": lambda s: s.env.step(np.zeros(3)),
    "step two dimensions": lambda s: s.env.step(np.zeros((1, 1))),
    "step scalar": lambda s: s.env.step(0.5),
    "step None": lambda s: s.env.step(None),
    "step text": lambda s: s.env.step("left"),
    "step list of text": lambda s: s.env.step(["left"]),
    "step nan": lambda s: s.env.step(np.array([NAN])),
    "step beyond": lambda s: s.env.step(np.array([1.5])),
    "step before reset": lambda s: LinearAxisEnv().step(np.zeros(1)),
    "options unknown": lambda s: s.env.reset(options={"gaol": 0.3}),
    "options list": lambda s: s.env.reset(options=["goal"]),
    "options beyond": lambda s: s.env.reset(options={"goal": 7}),
    "options text": lambda s: s.env.reset(options={"goal": "end"}),
    "options start nan": lambda s: s.env.reset(options={"start": NAN}),
    "way points": lambda s: LinearAxisTrackingEnv().reset(options={"way_points": [9.0]}),
    "way points text": lambda s: LinearAxisTrackingEnv().reset(options={"way_points": "there"}),
    "sway goals": lambda s: GantrySwayEnv(axes="xy").reset(options={"goal": 0.3}),
    "sway goals three": lambda s: GantrySwayEnv(axes="xy").reset(options={"goal": [0, 0, 0]}),
    "homing start": lambda s: HomingEnv().reset(options={"start": 3}),
    # vectors
    "vector none": lambda s: ServoVectorEnv(LinearAxisEnv, 0),
    "vector half": lambda s: ServoVectorEnv(LinearAxisEnv, 1.5),
    "vector threads": lambda s: ServoVectorEnv(LinearAxisEnv, 1, threads=0),
    "vector autoreset": lambda s: ServoVectorEnv(LinearAxisEnv, 1, autoreset_mode="never"),
    "vector argument": lambda s: ServoVectorEnv(LinearAxisEnv, 1, paylod=1),
    "vector step": lambda s: s.vector.step(np.zeros((3, 1))),
    "vector step text": lambda s: s.vector.step("left"),
    "vector step nan": lambda s: s.vector.step(np.full((2, 1), NAN)),
    "vector seeds": lambda s: s.vector.reset(seed=[1]),
    "vector options": lambda s: s.vector.reset(options={"gaol": 1}),
    "vector before reset": lambda s: ServoVectorEnv(LinearAxisEnv, 1).step(np.zeros((1, 1))),
    # registry
    "task unknown": lambda s: task("LinearAxs-v0"),
    "task of gymnasium": lambda s: task("CartPole-v1"),
    "task module": lambda s: task("nothing_here:Nudge-v0"),
    "task number": lambda s: task(3),
    "register nothing": lambda s: register(type("Nudge", (ServoEnv,), {})),
    "task without parts": lambda s: type("Nudge", (ServoEnv,), {"ID": "a/Nudge-v0"})(),
    # machines
    "axis drive None": lambda s: linear_axis(drive=None),
    "axis mechanics": lambda s: linear_axis(mechanics="belt"),
    "axis payload": lambda s: linear_axis(payload=-1),
    "axis parameter": lambda s: linear_axis(paylod=3),
    "axis parameters dict": lambda s: linear_axis(parameters={"payload": 3}),
    "parameters value": lambda s: LinearAxisParameters(efficiency=2),
    "parameters flag": lambda s: LinearAxisParameters(load_encoder=1),
    "rotary": lambda s: rotary_axis(mechanics="carousel"),
    "rotary parameter": lambda s: rotary_axis(payload=3.0),
    "gantry parameter": lambda s: gantry(gear_ratio=3.0),
    "linear parameter": lambda s: linear_axis(pay_load=3.0),
    "rotary untuned text": lambda s: rotary_axis(tuned="False"),
    "gantry untuned text": lambda s: gantry(tuned="False"),
    "linear untuned text": lambda s: linear_axis(tuned="False"),
    "commission untuned text": lambda s: commission_joint(s.machine, "x", tuned="False"),
    "tune without a move": lambda s: tune(s.machine, move=0.0),
    "gantry drive": lambda s: gantry(drive="nothing"),
    "positions name": lambda s: s.machine.reset(positions={"y": 0.1}),
    "positions beyond": lambda s: s.machine.reset(positions={"x": 9}),
    "positions text": lambda s: s.machine.reset(positions={"x": "end"}),
    "positions number": lambda s: s.machine.reset(positions=0.1),
    "machine step": lambda s: s.machine.step(-1),
    "machine step half": lambda s: s.machine.step(0.5),
    "machine step text": lambda s: s.machine.step("1 s"),
    "drives name": lambda s: s.machine.drives["y"],
    "snapshot": lambda s: s.machine.restore(b"nothing"),
    "snapshot number": lambda s: s.machine.restore(1 << 40),
    "snapshot text": lambda s: s.drive.restore("nothing"),
    "from_mjcf file": lambda s: Machine.from_mjcf("nothing.xml", {"a": "generic"}),
    "from_mjcf text": lambda s: Machine.from_mjcf("<mujoco><body/></mujoco>", {"a": "generic"}),
    "from_mjcf joint": lambda s: Machine.from_mjcf("<mujoco/>", {"a": "generic"}),
    "from_mjcf list": lambda s: Machine.from_mjcf("<mujoco/>", ["a"]),
    "from_mjcf None": lambda s: Machine.from_mjcf(None, {"a": "generic"}),
    "commission name": lambda s: commission_joint(s.machine, "y"),
    "commission speed": lambda s: commission_joint(s.machine, "x", max_velocity=0),
    # drives
    "model number": lambda s: load(3),
    "model bus": lambda s: load("generic", "profibus"),
    "read name": lambda s: s.drive.read("positon_actual_value"),
    "read index": lambda s: s.drive.read(0x9999),
    "read None": lambda s: s.drive.read(None),
    "write name": lambda s: s.drive.write("controlwrd", 6),
    "write text": lambda s: s.drive.write("controlword", "on"),
    "write None": lambda s: s.drive.write("controlword", None),
    "write large": lambda s: s.drive.write("controlword", 1 << 20),
    "write read-only": lambda s: s.drive.write("statusword", 1),
    "write nan": lambda s: s.drive.write("target_position", NAN),
    "inject": lambda s: s.drive.inject("encoder_los"),
    "inject number": lambda s: s.drive.inject(1.5),
    "cycle text": lambda s: s.drive.cycle("zero"),
    "commission list": lambda s: s.drive.commission(["motor_rated_torque"]),
    "map": lambda s: s.drive.map_pdos([["positon_actual_value"]], []),
    "node id": lambda s: Drive("generic", node_id=200),
    # masters
    "move beyond": lambda s: s.master.move_to(3.0),
    "move nan": lambda s: s.master.move_to(NAN),
    "move text": lambda s: s.master.move_to("end"),
    "move None": lambda s: s.master.move_to(None),
    "move axis": lambda s: s.master.move_to({"y": 0.1}),
    "mode unknown": lambda s: s.master.set_mode("csp8"),
    "mode number": lambda s: s.master.set_mode(99),
    "wait negative": lambda s: s.master.wait(-1.0),
    "master axis": lambda s: Master(MachinePort(s.other), "y"),
    # policies and more
    "policy unknown": lambda s: make("rukig", s.env),
    "policy of another task": lambda s: make("lqr", s.env),
    "policy number": lambda s: make(3, s.env),
    "policy file": lambda s: make("nothing.py:act", s.env),
    "faults of a bus": lambda s: LinearAxisEnv("kollmorgen_akd", faults=["drp at=cycle:1"]),
    "faults of a bus it has not": lambda s: LinearAxisEnv("festo_cmms", faults=["drop rate=0.1"]),
    # tuning
    "tune amplitude": lambda s: tune(s.machine, amplitude=NAN),
    "tune seed": lambda s: tune(s.machine, seed=-1),
    "tune an environment": lambda s: tune(s.env),
    "bode speed": lambda s: bode(s.machine, speed=100),
    "bode seed": lambda s: bode(s.machine, seed="one"),
    # of names, flags and types
    "joint of a machine": lambda s: s.machine.joint("y"),
    "port of an environment": lambda s: Master(MachinePort(s.env), "x"),
    "wait text": lambda s: s.master.wait("1 s"),
    "commission unknown": lambda s: s.drive.commission({"velocity_control_gan": 3}),
    "commission text": lambda s: s.drive.commission({"velocity_control_gain": "high"}),
    "flag": lambda s: LinearAxisEnv(previous_action="yes"),
    "vector of an id": lambda s: ServoVectorEnv("LinearAxis-v0", 2),
    "policy without environment": lambda s: make("ruckig", None),
    "policy of an id": lambda s: make("ruckig", "LinearAxis-v0"),
    "from_mjcf gears": lambda s: Machine.from_mjcf(ROBOT, {"elbow": "generic"}, gears=100),
    "robot goals": lambda s: RobotEnv(mjcf=ROBOT, goals=3),
    "robot site": lambda s: RobotEnv(mjcf=ROBOT, site=3),
    "robot xml": lambda s: RobotEnv(mjcf="<mujoco><worldbody>"),
    "timeout that is none": lambda s: s.master.enable(timeout=NAN),
    "timeout text": lambda s: s.master.enable(timeout="1"),
    "master of nothing": lambda s: Master(None, "x"),
    "faults number": lambda s: LinearAxisEnv(faults=3),
    "faults without a name": lambda s: LinearAxisEnv(faults={None: 0.1}),
    "robot drives": lambda s: RobotEnv(mjcf=ROBOT, drives=3),
    "robot folder": lambda s: RobotEnv(mjcf=ROBOT, folder=3),
    "robot without goals": lambda s: RobotEnv(mjcf=ROBOT, goals=[]),
    "commission nothing": lambda s: commission_joint(None, "elbow"),
    "commission no name": lambda s: commission_joint(s.machine, None),
    "episodes text": lambda s: Evaluator("LinearAxis-v0", episodes="3"),
    "family": lambda s: FAMILY["belt"] if "belt" in FAMILY else linear_axis(mechanics="belt "),
}
RAW = (
    "NoneType", "__init__", "object has no", "unexpected keyword", "not supported between",
    "could not convert", "unsupported operand", "positional argument", "unhashable", "must be real",
    "invalid literal", "has no len", "not iterable", "not subscriptable", "broadcast",
)


@pytest.fixture(scope="module")
def stage(env, x):
    class Stage:
        pass

    stage = Stage()
    stage.env, (stage.machine, stage.master) = env, x
    stage.drive, stage.other = stage.machine.drives["x"], linear_axis()
    stage.vector = ServoVectorEnv(LinearAxisEnv, 2, threads=1)
    stage.vector.reset(seed=0)
    return stage


@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_call_is_refused_by_us_in_words(name, stage):
    refused = (ValueError, TypeError, KeyError, SdoAbort, RuntimeError, gym.error.ResetNeeded)
    with pytest.raises(refused) as caught:
        CALLS[name](stage)
    frames = traceback.extract_tb(caught.value.__traceback__)
    text = words(caught.value)
    assert frames[-1].filename.startswith(HOUSE) or name == "drives name", text
    assert not any(raw in text for raw in RAW), text
    assert len(text) > 20, text


def test_there_are_more_than_80():
    assert len(CALLS) >= 80
