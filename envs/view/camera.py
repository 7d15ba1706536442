"""Where a picture is taken from: so that the machine and all its motion are in sight."""

import math

import mujoco
import numpy as np

MARGIN = 1.06  # around what has to be seen
NEAR, FARTHER, STEPS = 0.2, 1.03, 200  # m, and how the distance grows until all is in sight


def framed(
    model: mujoco.MjModel, data: mujoco.MjData, aspect: float, below: float, above: float
) -> mujoco.MjvCamera:
    """A free camera, from the side the model says.

    Args:
        model: of the machine.
        data: its state; is left as it is.
        aspect: width of the picture over its height.
        below, above: shares of the height that panels hide.
    """
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    points = _seen(model, data)
    if not len(points):
        return camera
    turn, lift = math.radians(camera.azimuth), math.radians(camera.elevation)
    forward = np.array(
        [math.cos(lift) * math.cos(turn), math.cos(lift) * math.sin(turn), math.sin(lift)]
    )
    right = np.array([math.sin(turn), -math.cos(turn), 0.0])
    up = np.cross(right, forward)
    half = math.tan(math.radians(float(model.vis.global_.fovy)) / 2) / MARGIN
    low, high = -1.0 + 2.0 * below, 1.0 - 2.0 * above
    middle, free = (low + high) / 2, (high - low) / 2
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    away = points - centre
    x, y, z = away @ right, away @ up, away @ forward
    distance = NEAR
    for _ in range(STEPS):
        depth = z + distance
        wide = half * aspect * depth
        if depth.min() > 0.0:
            place = y / (half * depth)
            rise = (place.max() + place.min()) / 2  # of what is seen, over the middle
            if (np.abs(x) <= wide).all() and (place.max() - place.min()) / 2 <= free:
                break
        distance *= FARTHER
    camera.distance = distance
    camera.lookat = centre + up * (rise - middle) * half * distance
    return camera


def _seen(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Corners of all that is no floor, with each sliding joint at both its ends, ``(n, 3)``."""
    scratch = mujoco.MjData(model)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).T.reshape(-1, 3)
    planes = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)
    geoms = [g for g in range(model.ngeom) if model.geom_type[g] not in planes]
    slides = model.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE)
    limited = np.flatnonzero(slides & (model.jnt_limited > 0))
    found = []
    for end in (None, 0, 1):
        scratch.qpos[:] = data.qpos
        if end is not None:
            scratch.qpos[model.jnt_qposadr[limited]] = model.jnt_range[limited, end]
        mujoco.mj_kinematics(model, scratch)
        for geom in geoms:
            centre, size = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            turned = scratch.geom_xmat[geom].reshape(3, 3)
            found.append((centre + corners * size) @ turned.T + scratch.geom_xpos[geom])
    return np.concatenate(found) if found else np.zeros((0, 3))
