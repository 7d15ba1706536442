"""Finds what hinders a joint: contacts of the bodies it moves, or other forces."""

import mujoco
import numpy as np

LARGE = 0.5  # share of the drive's force from which an opposing force is reported


def hindrances(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> list[str]:
    """Return what stops a joint: contacts in its way, otherwise the forces against its drive.

    Such forces are its limit, an equality such as a weld, its damping, its spring, and the weight
    and the motion of other joints. Without any, the contacts of a free base are returned, since the
    robot may have fallen.

    Args:
        model: the MuJoCo model of the robot.
        data: its state after a physics step.
        joint: number of the joint.
    """
    if found := obstacles(model, data, joint):
        return found
    dof = int(model.jnt_dofadr[joint])
    force, damping = data.qfrc_actuator[dof], -model.dof_damping[dof] * data.qvel[dof]
    limit = (data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT) & (data.efc_id == joint)
    tied = {f"{_equality(model, i)}": taken for i, taken in _equalities(model, data, dof).items()}
    against = tied | {
        "its limit": data.qfrc_constraint[dof] if limit.any() else 0.0,
        f"its damping of {model.dof_damping[dof]:g}": damping,
        "its spring": data.qfrc_spring[dof],
        "weight or the motion of other joints": -data.qfrc_bias[dof],
    }
    slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    unit = "N" if slides else "Nm"
    found = [
        f"{what} takes {abs(taken):.3g} {unit}, the drive gives {abs(force):.3g} {unit}"
        for what, taken in against.items()
        if taken * force < 0.0 and abs(taken) > LARGE * abs(force)
    ]
    root = int(model.body_rootid[model.jnt_bodyid[joint]])
    base = int(model.body_jntadr[root])
    if not found and base >= 0 and model.jnt_type[base] == mujoco.mjtJoint.mjJNT_FREE:
        found = [f"{contact} (the base is free)" for contact in obstacles(model, data, base)]
    return found


def _equalities(model: mujoco.MjModel, data: mujoco.MjData, dof: int) -> dict[int, float]:
    """Force of each equality constraint along a degree of freedom (N or Nm)."""
    forces: dict[int, float] = {}
    own = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    for i in sorted(set(data.efc_id[own].tolist())):
        rows, along = np.where(own & (data.efc_id == i), data.efc_force, 0.0), np.zeros(model.nv)
        mujoco.mj_mulJacTVec(model, data, along, rows)
        forces[i] = float(along[dof])
    return forces


def _equality(model: mujoco.MjModel, i: int) -> str:
    """Describe an equality by its kind and its name, or by the objects that it couples."""
    kind = mujoco.mjtEq(model.eq_type[i]).name.removeprefix("mjEQ_").lower()
    name = model.equality(i).name
    objects, numbers = mujoco.mjtObj(model.eq_objtype[i]), (model.eq_obj1id[i], model.eq_obj2id[i])
    if kind in ("joint", "tendon"):
        objects = mujoco.mjtObj.mjOBJ_JOINT if kind == "joint" else mujoco.mjtObj.mjOBJ_TENDON
    parts = [mujoco.mj_id2name(model, objects, int(n)) or f"number {n}" for n in numbers if n >= 0]
    return f"the {kind} constraint {f'{name!r}' if name else 'of ' + ' and '.join(parts)}"


def obstacles(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> list[str]:
    """Return the contacts in the way of a joint, such as ``"base_col touches upperarm_col"``.

    The strongest contact comes first.

    Args:
        model: the MuJoCo model of the robot.
        data: its state; the contacts are those of the last physics step.
        joint: number of the joint, which moves its body and all bodies below it.
    """
    moved = _below(model, int(model.jnt_bodyid[joint]))
    found: dict[str, float] = {}
    force = np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        inner, outer = contact.geom
        if moved[model.geom_bodyid[inner]] == moved[model.geom_bodyid[outer]]:
            continue  # both move, or neither
        if not moved[model.geom_bodyid[inner]]:
            inner, outer = outer, inner
        mujoco.mj_contactForce(model, data, i, force)
        name = f"{_geom(model, inner)} touches {_geom(model, outer)}"
        found[name] = max(found.get(name, 0.0), abs(float(force[0])))
    return sorted((name for name in found if found[name] > 0.0), key=lambda name: -found[name])


def _below(model: mujoco.MjModel, body: int) -> np.ndarray:
    """Whether a body belongs to the tree below `body`, itself included, shape ``(nbody,)``."""
    moved = np.zeros(model.nbody, bool)
    moved[body] = True
    for each in range(body + 1, model.nbody):  # parents come first
        moved[each] = moved[model.body_parentid[each]]
    return moved


def _geom(model: mujoco.MjModel, geom: int) -> str:
    name = model.geom(geom).name
    return name or f"a geom of {model.body(model.geom_bodyid[geom]).name or 'a body'}"
