"""What is in the way of a joint: the contacts between what it moves and all else."""

import mujoco
import numpy as np


def obstacles(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> list[str]:
    """Contacts in the way of a joint, the strongest first: ``"base_col touches upperarm_col"``.

    Args:
        model: of the robot.
        data: in the state looked at; its contacts are those of the last physics step.
        joint: number of the joint; what hangs on its body is what it moves.
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
    """Which bodies hang on `body`, itself too, shape ``(nbody,)``."""
    moved = np.zeros(model.nbody, bool)
    moved[body] = True
    for each in range(body + 1, model.nbody):  # parents come first
        moved[each] = moved[model.body_parentid[each]]
    return moved


def _geom(model: mujoco.MjModel, geom: int) -> str:
    name = model.geom(geom).name
    return name or f"a geom of {model.body(model.geom_bodyid[geom]).name or 'a body'}"
