"""A machine's physics is `mj_step`, bit by bit, but for the law of its friction.

The oracle is MuJoCo alone: a copy of the machine's model takes `mj_step` with the torques the
drives gave. Friction is ours; where there is any, a callback of MuJoCo adds the forces the machine
computed to the passive ones, so that all else of the step is still MuJoCo's own.
"""

import contextlib
import itertools
import random
import threading
from collections import Counter

import mujoco
import numpy as np
import pytest

from servogym.envs import Machine, rotary_axis
from servogym.envs.engine import loop
from servogym.envs.engine.machine import NO_IMAGES
from servogym.envs.engine.physics import STATE

TICKS = 60
MODELS = {
    "slide": """
     <body><joint name="x" type="slide" axis="1 0 0" range="-.02 .02" damping="3" {friction}/>
      <geom size=".05" mass="2"/><site name="s"/></body>""",
    "arm, falling balls and a floor": """
     <geom type="plane" size="2 2 .1" pos="0 0 -.25"/>
     <body><joint name="x" type="hinge" axis="0 1 0" armature=".01" {friction}/>
      <geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="2"/>
      <body pos=".3 0 0"><joint name="y" type="hinge" axis="0 1 0" damping=".1"/>
       <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/>
       <site name="s"/></body></body>
     <body pos=".2 0 .08"><freejoint/><geom size=".05" mass=".3" condim="4"/></body>
     <body pos=".25 .02 .2"><freejoint/><geom type="box" size=".04 .03 .02" mass=".2"/></body>""",
    "ball joint in water": """
     <body><joint name="x" type="slide" axis="0 0 1" stiffness="40" {friction}/>
      <geom size=".05" mass="2"/>
      <body pos="0 0 .1"><joint type="ball" damping=".01"/>
       <geom type="ellipsoid" size=".2 .05 .03" mass=".4" fluidshape="ellipsoid"/>
       <site name="s"/></body></body>""",
    "beside a motor of the user's own laws": """
     <body><joint name="x" type="slide" axis="1 0 0" {friction}/><geom size=".05" mass="2"/>
      <body pos="0 0 .2"><joint name="y" type="hinge" axis="0 1 0" damping=".1"/>
       <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/>
       <site name="s"/></body></body>""",
    "welded, tied and with a motor that lags": """
     <body><joint name="x" type="slide" axis="1 0 0" {friction}/><geom size=".05" mass="2"/></body>
     <body pos="0 1 0"><joint name="y" type="slide" axis="1 0 0" frictionloss=".5"/>
      <geom size=".05" mass="1"/><site name="s"/></body>
     <body name="a" pos="0 0 1"><freejoint/><geom size=".05" mass=".2"/></body>""",
}
EXTRA = {
    "welded, tied and with a motor that lags": """
     <equality><joint joint1="y" joint2="x" polycoef="0 1 0 0 0"/><weld body1="a" body2="world"/>
     </equality>
     <tendon><fixed name="t" range="-1 1" limited="true" stiffness="5" frictionloss=".1">
      <joint joint="x" coef="1"/><joint joint="y" coef="-.5"/></fixed></tendon>""",
}
OF_CALLBACKS = """
 <general joint="y" dyntype="user" gaintype="user" biastype="user" actdim="1" ctrlrange="-1 1"/>"""
LAGGING = '<general joint="y" dyntype="filter" dynprm=".01" gainprm="5" ctrlrange="-1 1"/>'
MJCF = """
<mujoco><option timestep="0.00025" density="{density}" viscosity=".001"/>
 <worldbody>{body}</worldbody>{extra}
 <actuator><motor name="x" joint="x" gear="60"/>{lagging}</actuator>
 <sensor><accelerometer site="s"/><gyro site="s"/><force site="s"/><torque site="s"/>
  <velocimeter site="s"/><framelinacc objtype="site" objname="s"/>
  <subtreelinvel body="world"/></sensor></mujoco>"""
KINDS = [name.removeprefix("mjINT_") for name in mujoco.mjtIntegrator.__members__]
INTEGRATORS = [name for name in KINDS if name != "RK4"]
SOLVERS = ("PGS", "CG", "NEWTON")
CONES = ("PYRAMIDAL", "ELLIPTIC")
JACOBIANS = ("DENSE", "SPARSE")
DISABLE = [f for f in dir(mujoco.mjtDisableBit) if f.startswith("mjDSBL_")]
ENABLE = [f for f in dir(mujoco.mjtEnableBit) if f.startswith("mjENBL_") and f != "mjENBL_IPC"]
FLAGS = ["none", *DISABLE, *ENABLE]
FRICTIONS = (0.0, 1.5)
SCENARIOS = list(
    itertools.product(MODELS, FRICTIONS, INTEGRATORS, SOLVERS, CONES, JACOBIANS, FLAGS)
)


def model_of(name, friction, integrator, solver, cone, jacobian, flag):
    own = f'frictionloss="{friction}"' if friction else ""
    text = MJCF.format(
        density=1000 if "water" in name else 0, body=MODELS[name].format(friction=own),
        extra=EXTRA.get(name, ""),
        lagging=LAGGING if "lags" in name else OF_CALLBACKS if "laws" in name else "",
    )
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.integrator = int(getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}"))
    model.opt.solver = int(getattr(mujoco.mjtSolver, f"mjSOL_{solver}"))
    model.opt.cone = int(getattr(mujoco.mjtCone, f"mjCONE_{cone}"))
    model.opt.jacobian = int(getattr(mujoco.mjtJacobian, f"mjJAC_{jacobian}"))
    if flag in DISABLE:
        model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, flag))
    if flag in ENABLE:
        model.opt.enableflags |= int(getattr(mujoco.mjtEnableBit, flag))
    return model


def all_of(model, data):
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return b"".join(
        np.asarray(part).tobytes()
        for part in (state, data.qacc, data.qfrc_constraint, data.sensordata, data.energy,
                     data.solver_fwdinv, data.cfrc_int)
    )


LAWS = {
    "act_dyn": lambda model, data, i: 20.0 * (data.ctrl[i] - data.act[0]),
    "act_gain": lambda model, data, i: 5.0 + data.qpos[1],
    "act_bias": lambda model, data, i: -0.1 * data.qvel[1],
}


@contextlib.contextmanager
def laws():
    """Callbacks of MuJoCo for the actuator with laws of the user's own; -> how often each ran."""
    calls = Counter()

    def counting(name, law):
        def counted(*arguments):
            calls[name] += 1
            return law(*arguments)

        return counted

    for name, law in LAWS.items():
        getattr(mujoco, f"set_mjcb_{name}")(counting(name, law))
    try:
        yield calls
    finally:
        for name in LAWS:
            getattr(mujoco, f"set_mjcb_{name}")(None)


def differs(scenario):
    """The first physics step after which the machine is not what `mj_step` makes of it."""
    machine = Machine(model_of(*scenario), {"x": "generic"})
    plain = mujoco.MjModel.from_xml_string("<mujoco/>")
    plain = model_of(*scenario)
    plain.opt.disableflags = machine.model.opt.disableflags
    plain.actuator_ctrlrange[:] = machine.model.actuator_ctrlrange
    plain.actuator_ctrllimited[:] = machine.model.actuator_ctrllimited
    plain.dof_frictionloss[:] = machine.model.dof_frictionloss
    data = mujoco.MjData(plain)
    mujoco.mj_forward(plain, data)
    state = np.empty(mujoco.mj_stateSize(plain, STATE))
    mujoco.mj_getState(machine.model, machine.data, state, STATE)
    mujoco.mj_setState(plain, data, state, STATE)
    joint, dof = machine.mechanics[0], int(machine.couplings[0].dof)
    rubs = bool(scenario[1])

    def friction(model, data):
        data.qfrc_passive[dof] += float(joint.friction_force[0])

    draw = random.Random(repr(scenario))
    for tick in range(TICKS):
        data.qfrc_applied[dof] = machine.data.qfrc_applied[dof] = draw.uniform(-8.0, 8.0)
        if plain.nu > 1:
            machine.data.ctrl[1] = draw.uniform(-2.0, 2.0)
        with laws() as calls:
            loop.run(machine.addresses, 1, NO_IMAGES, NO_IMAGES)
            ours = calls.copy()
            data.ctrl[:] = machine.data.ctrl
            mujoco.set_mjcb_passive(friction if rubs else None)
            try:
                mujoco.mj_step(plain, data)
            finally:
                mujoco.set_mjcb_passive(None)
        if all_of(machine.model, machine.data) != all_of(plain, data):
            return tick
        if scenario[2] != "DISCRETE":
            assert ours + ours == calls, "callbacks run as often as in mj_step"
    assert np.isfinite(data.qpos).all()
    assert np.ptp(data.qvel) > 0.0 or plain.nv == 1, "something moves"
    return None


def sample():
    """Each value of each part of a scenario, a few times."""
    draw = random.Random(7)
    parts = MODELS, FRICTIONS, INTEGRATORS, SOLVERS, CONES, JACOBIANS, FLAGS
    columns = []
    for part in parts:
        column = [each for _ in range(2 * len(FLAGS) // len(part) + 1) for each in part]
        draw.shuffle(column)
        columns.append(column)
    return [tuple(row) for row in zip(*columns, strict=False)]


def test_a_step_is_mj_step_bit_by_bit():
    assert [(each, tick) for each in sample() if (tick := differs(each)) is not None] == []


@pytest.mark.slow
@pytest.mark.parametrize("part", range(8))
def test_every_step_is_mj_step_bit_by_bit(part):
    scenarios = SCENARIOS[part::8]
    assert [(each, tick) for each in scenarios if (tick := differs(each)) is not None] == []


def refused(machine, name, value):
    usual = getattr(machine.model.opt, name)
    before = all_of(machine.model, machine.data)
    setattr(machine.model.opt, name, value)
    with pytest.raises(
        ValueError, match=r"model\.opt .*timestep.* not RK4.*build the machine anew"
    ):
        machine.step()
    assert all_of(machine.model, machine.data) == before, "nothing has moved"
    setattr(machine.model.opt, name, usual)
    machine.step()


def test_an_integrator_or_a_timestep_changed_in_mid_run_is_refused_or_followed():
    machine = Machine(model_of(*SCENARIOS[0]), {"x": "generic"})
    machine.step(3)
    for value in (int(mujoco.mjtIntegrator.mjINT_RK4), 17, -1):
        refused(machine, "integrator", value)
    for value in (1e-4, 5e-4, float("nan")):
        refused(machine, "timestep", value)
    time = machine.time
    assert time == pytest.approx(machine.data.time), "the drives' time is MuJoCo's"
    machine.model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    machine.step()
    assert machine.time == pytest.approx(time + machine.cycle_time)


@pytest.mark.parametrize("name", ["control", "passive"])
def test_callbacks_in_python_run_in_any_thread_once_a_step(name):
    """MuJoCo compiles no model while they are set, so the guard of a thread may compile none."""
    machine, calls = Machine(model_of(*SCENARIOS[0]), {"x": "generic"}), []
    failed = []

    def step():
        try:
            machine.step(5)
        except BaseException as error:
            failed.append(error)

    getattr(mujoco, f"set_mjcb_{name}")(lambda model, data: calls.append(data.time))
    try:
        with pytest.raises(ValueError, match=rf"build the machine first.*set_mjcb_{name} then"):
            rotary_axis()
        for _ in range(2):
            thread = threading.Thread(target=step)
            thread.start()
            thread.join()
        step()
    finally:
        getattr(mujoco, f"set_mjcb_{name}")(None)
    assert failed == []
    assert len(calls) == 15 * machine.physics_steps
