"""Dry friction holds and slips as it must: closed forms, and MuJoCo's own constraint."""

import math

import mujoco
import numpy as np
import pytest

from servogym.envs import FAMILY, Machine, gantry, linear_axis

G = 9.81
BARE = {"coulomb_friction": 12.0, "viscous_friction": 0.0}
ARM = """
<mujoco><option timestep="0.00025" integrator="implicitfast"/>
 <worldbody><body><joint name="shoulder" type="hinge" axis="0 1 0" frictionloss="{0}"/>
  <geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="3"/>
  <body pos=".4 0 0"><joint name="elbow" type="hinge" axis="0 1 0" frictionloss="{1}"/>
   <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="2"/></body></body></worldbody>
 <actuator><motor name="shoulder" joint="shoulder" gear="50"/>
  <motor name="elbow" joint="elbow" gear="50"/></actuator></mujoco>"""


def drift(machine, seconds=3.0):
    """Largest way of any joint within the time, after a moment in which springs may settle (m)."""
    machine.step(round(0.2 / machine.cycle_time))
    before = machine.data.qpos.copy()
    machine.step(round(seconds / machine.cycle_time))
    return np.abs(machine.data.qpos - before).max()


def static_friction(p):
    chain = p.chain_drag + p.chain_drag_growth * (0.2 + 0.02)
    return max(p.coulomb_friction, p.static_friction) + chain


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("mechanics", [name for name in FAMILY if name != "vertical"])
def test_an_axis_pulled_with_less_than_its_friction_does_not_move(mechanics, sign):
    machine = linear_axis(mechanics=mechanics, cogging_torque=0.0)
    machine.reset(positions={"x": 0.2})
    pull = 0.99 * sign * static_friction(FAMILY[mechanics])
    machine.data.body("payload").xfrc_applied[0] = pull
    assert drift(machine) < 1e-12
    machine.data.body("payload").xfrc_applied[0] = 1.02 * pull
    machine.step(2000)
    assert sign * (machine.data.qpos.sum() - 0.2) > 1e-3


def test_an_axis_stays_on_a_slope_with_the_drive_off():
    assert drift(linear_axis(inclination=5.0)) == 0.0, "5.6 N of weight, 12 N of friction"
    steepest = math.degrees(math.asin(12.0 / (6.5 * G)))
    for slope, holds in ((0.99 * steepest, True), (1.01 * steepest, False)):
        machine = linear_axis(inclination=slope)
        machine.reset(positions={"x": 0.3})
        assert (drift(machine) == 0.0) == holds


@pytest.mark.parametrize("mechanics", ["vertical", "toothed_belt"])
def test_the_brake_holds_before_an_elastic_transmission(mechanics):
    machine = linear_axis(mechanics=mechanics, inclination=90.0, brake_torque=4.0)
    machine.reset(positions={"x": 0.3})
    assert drift(machine, 1.0) < 1e-9


@pytest.mark.parametrize("machine", [gantry, lambda: gantry(x_drives=2)])
def test_a_gantry_pulled_with_less_than_its_friction_does_not_move(machine):
    machine = machine()
    machine.reset(positions={"y": 0.2, "z": -0.1})
    frictions = 12.0 * (len(machine.drives) - 2)
    machine.data.body("payload").xfrc_applied[:2] = 0.95 * frictions, 0.95 * 12.0
    assert drift(machine) < 1e-8, "the skew of the bridge dies out slowly"


@pytest.mark.parametrize("velocity", [0.1, -0.3])
def test_a_sliding_axis_stops_where_coulomb_says_and_stays(velocity):
    machine = linear_axis(**BARE)
    machine.reset(positions={"x": 0.25})
    machine.data.qvel[0] = velocity
    mass = 6.5 + machine.model.dof_armature[0]
    deceleration = 12.0 / mass
    machine.step(math.ceil(abs(velocity) / deceleration / machine.cycle_time) + 1)
    way = velocity * abs(velocity) / (2 * deceleration)
    step = machine.model.opt.timestep
    assert machine.data.qpos[0] - 0.25 == pytest.approx(way, abs=abs(velocity) * step)
    rest = machine.data.qpos[0]
    machine.step(1000)
    assert machine.data.qpos[0] == rest


def test_friction_against_an_end_stop_leaves_no_motion():
    machine = linear_axis()
    machine.reset(positions={"x": 0.515})
    body = machine.data.body("payload")
    body.xfrc_applied[0] = 100.0
    machine.step(1000)
    assert machine.data.qpos[0] == pytest.approx(0.52, abs=1e-4)
    assert drift(machine) < 1e-9
    body.xfrc_applied[0] = 0.0
    assert drift(machine) < 1e-9


def test_friction_never_works_and_never_exceeds_its_limit():
    generator = np.random.default_rng(3)
    machine = Machine.from_mjcf(ARM.format(4.0, 2.0), {"shoulder": "generic", "elbow": "generic"})
    step, seen = machine.physics_steps, set()
    for _ in range(4000 // step):
        machine.data.qfrc_applied[:] = generator.normal(0.0, 12.0, 2)
        machine.step()
        force, velocity = machine.mechanics["friction_force"][:, 0], machine.data.qvel
        limit = machine.mechanics["friction_limit"][:, 0]
        assert (np.abs(force) <= limit).all()
        seen.update(np.sign(np.round(np.abs(force) - limit, 12)))
        # a joint that a later one of the same step has moved again stops in the next
        assert (force * velocity < 0.02 * limit).all()
    assert seen == {-1.0, 0.0}, "it has both held and slipped"


def test_two_coupled_joints_hold_their_arm():
    weight = G * np.array([3 * 0.2 + 2 * 0.55, 2 * 0.15])
    machine = Machine.from_mjcf(
        ARM.format(*1.01 * weight), {"shoulder": "generic", "elbow": "generic"}
    )
    assert drift(machine) < 1e-9


@pytest.mark.parametrize("frictions", [(4.0, 2.0), (1.0, 6.0), (12.0, 0.5), (0.0, 3.0)])
def test_two_coupled_joints_slip_as_with_the_constraint_of_mujoco(frictions):
    machine = Machine.from_mjcf(ARM.format(*frictions), {"shoulder": "generic", "elbow": "generic"})
    oracle = mujoco.MjModel.from_xml_string(ARM.format(*frictions))
    oracle.dof_solimp[:, :2], oracle.dof_solref[:, 0] = 0.9999, 0.0005
    data = mujoco.MjData(oracle)
    apart = 0.0
    for _ in range(2000):
        machine.step()
        mujoco.mj_step(oracle, data, machine.physics_steps)
        apart = max(apart, np.abs(machine.data.qpos - data.qpos).max())
    assert np.ptp(data.qpos) > 0.1, "it has fallen"
    assert apart < 5e-3, "rad, of a fall through radians"


def test_forces_of_the_user_stay_and_count():
    machine = linear_axis(cogging_torque=0.1, cogging_order=1, **BARE)
    machine.data.qfrc_applied[0] = 5.0
    assert drift(machine) < 1e-12
    machine.data.qfrc_applied[0] = 40.0
    machine.step(100)
    assert machine.data.qvel[0] > 0.01
    assert machine.data.qfrc_applied[0] == 40.0


def test_rk4_is_refused_and_from_mjcf_sets_implicitfast():
    text = ARM.replace("implicitfast", "RK4").format(0, 0)
    with pytest.raises(ValueError, match=r"integrator RK4 .*from_mjcf"):
        Machine(mujoco.MjModel.from_xml_string(text), {"elbow": "generic"})
    machine = Machine.from_mjcf(text, {"elbow": "generic"})
    assert machine.model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)


def test_a_restored_machine_slips_bit_by_bit_the_same():
    machine = Machine.from_mjcf(ARM.format(4.0, 2.0), {"shoulder": "generic", "elbow": "generic"})
    machine.step(300)
    snapshot = machine.snapshot()
    runs = []
    for _ in range(2):
        machine.restore(snapshot)
        machine.step(300)
        runs.append(machine.data.qpos.tobytes() + machine.data.qvel.tobytes())
    assert runs[0] == runs[1]


@pytest.mark.parametrize(("force", "holds"), [(9.0, True), (-15.5, True), (17.0, False)])
def test_joints_that_an_equality_couples_hold_with_both_frictions(force, holds):
    text = """
    <mujoco><option timestep="0.00025" integrator="implicitfast"/>
     <worldbody>
      <body><joint name="a" type="slide" axis="1 0 0" frictionloss="10"/>
       <geom size=".05" mass="2"/></body>
      <body pos="0 1 0"><joint name="b" type="slide" axis="1 0 0" frictionloss="6"/>
       <geom size=".05" mass="3"/></body>
     </worldbody>
     <equality><joint joint1="b" joint2="a" polycoef="0 1 0 0 0"/></equality>
     <actuator><motor name="a" joint="a" gear="50"/><motor name="b" joint="b" gear="50"/></actuator>
    </mujoco>"""
    machine = Machine.from_mjcf(text, {"a": "generic", "b": "generic"})
    machine.data.qfrc_applied[0] = force
    assert (drift(machine) < 1e-9) == holds
