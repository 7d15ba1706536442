"""The machine as a scene: bodies with their shapes, ghosts of the target, switches and limits."""

from typing import Any

import mujoco
import numpy as np

from ...drive.diagrams import Mode
from ..engine.coupling import SWITCHES
from ..engine.machine import Machine
from ..view.camera import beside, corners, floor, visible_points
from ..view.decor import Part, parts

PLACE = np.dtype("<f4")
TARGETS = (Mode.PROFILE_POSITION, Mode.HOMING)
THIN = 0.004  # m, of a limit plate
MOST_VERTICES = 60_000  # of a mesh; a larger one is shown as its box


def scene(machine: Machine) -> dict[str, Any]:
    """The constant part of the scene for the browser: bodies and their shapes."""
    model = machine.model
    moving = [body for body in range(model.nbody) if model.body_weldid[body]]
    shapes = [shape for geom in range(model.ngeom) if (shape := _shape(model, geom))]
    points = visible_points(model, machine.data)
    bar = beside(model, points) if len(points) else []
    decor = [*parts(model), *bar]
    standing = [corners(part) for part in decor if not part.body]
    points = np.concatenate([points, *standing]) if len(points) else np.zeros((1, 3))
    low, high = points.min(axis=0), points.max(axis=0)
    return {
        "bodies": moving,
        "shapes": [*shapes, *map(_part, decor)],
        "low": low.tolist(),
        "high": high.tolist(),
        "view": [float(model.vis.global_.azimuth), float(model.vis.global_.elevation)],
        "floor": floor(model),
        "marks": [mark for axis in range(len(machine.drives)) for mark in _marks(machine, axis)],
    }


def _shape(model: mujoco.MjModel, geom: int) -> dict[str, Any] | None:
    colour = model.geom_rgba[geom]
    material = model.geom_matid[geom]
    if material >= 0:
        colour = model.mat_rgba[material]
    if colour[3] == 0.0 or model.geom_group[geom] > 2:
        return None
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    shape: dict[str, Any] = {
        "kind": kind.name.removeprefix("mjGEOM_").lower(),
        "body": int(model.geom_bodyid[geom]),
        "pos": model.geom_pos[geom].tolist(), "quat": model.geom_quat[geom].tolist(),
        "size": model.geom_size[geom].tolist(), "colour": colour.tolist(),
    }
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        begin, number = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        if number > MOST_VERTICES:
            shape |= {"kind": "box", "size": model.geom_aabb[geom][3:].tolist()}
        else:
            shape["vertices"] = model.mesh_vert[begin : begin + number].ravel().tolist()
            shape["faces"] = model.mesh_face[face : face + faces].ravel().tolist()
    return shape


def _part(part: Part) -> dict[str, Any]:
    """A shape that is not a geom of the model."""
    kind = mujoco.mjtGeom(part.kind).name.removeprefix("mjGEOM_").lower()
    return {
        "kind": kind, "body": part.body, "pos": part.place, "quat": part.turned,
        "size": part.size, "colour": part.colour, "label": part.label, "decor": True,
    }


def _marks(machine: Machine, axis: int) -> list[dict[str, Any]]:
    """Software limits and switches of a sliding joint, drawn where its body would be at them."""
    model, coupling = machine.model, machine.couplings[axis]
    joint = int(model.dof_jntid[coupling.dof])
    if model.jnt_type[joint] != int(mujoco.mjtJoint.mjJNT_SLIDE):
        return []
    name = [*machine.drives][axis]
    low, high = machine.range(name)
    spans = []
    for number, switch in enumerate(SWITCHES):
        begin, end = float(coupling.switch_from[number]), float(coupling.switch_to[number])
        begin, end = max(begin, low), min(end, high)
        if begin < end:
            spans.append((f"{switch}", begin, end, number))
    drive = machine.drives[name]
    unit = float(drive.axis.rad_per_position_unit) / float(coupling.gear)
    zero = float(drive.axis.zero_counts) * float(drive.axis.rad_per_increment)
    for end_name in ("min", "max"):
        row = drive.objects.names.get(f"{end_name}_position_limit")
        if row is not None:
            place = float(row.get()) * unit + zero / float(coupling.gear)
            spans.append(("software_limit", place - THIN / 2, place + THIN / 2, -1))
    data = mujoco.MjData(model)
    marks = []
    for kind, begin, end, number in spans:
        data.qpos[:] = machine.data.qpos
        data.qpos[coupling.qpos] = (begin + end) / 2
        mujoco.mj_kinematics(model, data)
        marks.append(
            {
                "kind": kind, "axis": axis, "switch": number, "length": end - begin,
                "pos": _centre(model, data, joint),
                "along": data.xaxis[joint].tolist(),
            }
        )
    return marks


def _centre(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> list[float]:
    """The centre of the bodies that the joint carries."""
    body = int(model.jnt_bodyid[joint])
    while not model.body_geomnum[body] and body + 1 < model.nbody:
        body += 1
    return data.xpos[body].tolist()


class Poses:
    """The poses of all bodies, now and at the target, as text of float32."""

    def __init__(self, machine: Machine):
        self._machine = machine
        model = machine.model
        self._bodies = [body for body in range(model.nbody) if model.body_weldid[body]]
        self._ghost = mujoco.MjData(model)

    def now(self) -> dict[str, Any]:
        """Poses in the order of the scene's bodies: position and quaternion (w first)."""
        machine = self._machine
        here, ghost = machine.data, self._ghost
        ghost.qpos[:] = here.qpos
        away = False
        for coupling, drive in zip(machine.couplings, machine.drives.values(), strict=True):
            axis = drive.axis
            if axis.homed and int(axis.mode) in TARGETS and axis.control:
                distance = float(axis.target - axis.position) / float(coupling.gear)
                ghost.qpos[coupling.qpos] += distance
                away = away or abs(distance) > 1e-4
        mujoco.mj_kinematics(machine.model, ghost)
        active = [coupling.switch_active.tolist() for coupling in machine.couplings]
        return {"now": self._packed(here), "ghost": self._packed(ghost) if away else None,
                "switches": active}

    def _packed(self, data: mujoco.MjData) -> list[float]:
        poses = np.hstack((data.xpos[self._bodies], data.xquat[self._bodies])).astype(PLACE)
        return np.round(poses.astype(float), 5).ravel().tolist()
