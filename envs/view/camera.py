"""Chooses the camera of a picture so that the machine and all its motion are visible."""

import math

import mujoco
import numpy as np

from .decor import Part, parts, scale

MARGIN = 1.06  # around the visible points
NEAR, FARTHER, STEPS = 0.2, 1.03, 200  # first distance (m), its growth, and the number of tries
POSES = 24  # random poses of the hinges, besides the present one


CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).T.reshape(-1, 3)
ROUND = tuple(
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"))
    for kind in ("CYLINDER", "SPHERE", "CAPSULE", "ELLIPSOID")
)
RIMS = np.array([[np.cos(a), np.sin(a), z] for z in (-1, 1) for a in np.arange(8) * np.pi / 4])
FLOORS = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))


def framed(
    model: mujoco.MjModel, data: mujoco.MjData, aspect: float, below: float, above: float
) -> mujoco.MjvCamera:
    """Return a free camera with the direction of the model that shows the whole machine.

    Args:
        model: the MuJoCo model of the machine.
        data: its state, which is not changed.
        aspect: width of the picture over its height.
        below, above: shares of the height that panels hide.
    """
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    points = visible_points(model, data)
    if not len(points):
        return camera
    standing = [part for part in parts(model) if not part.body]
    points = np.concatenate([points, *map(corners, [*standing, *beside(model, points)])])
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
            rise = (place.max() + place.min()) / 2  # of the visible points, above the middle
            if (np.abs(x) <= wide).all() and (place.max() - place.min()) / 2 <= free:
                break
        distance *= FARTHER
    camera.distance = distance
    camera.lookat = centre + up * (rise - middle) * half * distance
    return camera


def visible_points(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return points that geoms other than the floor can reach, ``(n, 3)`` (m).

    Slides are moved to both their ends; hinges are put into random poses.
    """
    scratch = mujoco.MjData(model)
    geoms = np.flatnonzero(~np.isin(model.geom_type, FLOORS))
    slides = model.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE)
    limited = np.flatnonzero(slides & (model.jnt_limited > 0))
    arms = np.flatnonzero((model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)) & _drives(model))
    low = np.where(model.jnt_limited > 0, model.jnt_range[:, 0], -np.pi)[arms]
    high = np.where(model.jnt_limited > 0, model.jnt_range[:, 1], np.pi)[arms]
    round_ones = np.isin(model.geom_type[geoms], ROUND)[:, None, None]
    hulls = np.where(round_ones, RIMS, np.concatenate([CORNERS, CORNERS]))
    generator = np.random.default_rng(0)  # the same picture each time
    found = []
    for number in range(3 + POSES * bool(len(arms))):
        scratch.qpos[:] = data.qpos
        if number in (1, 2):
            scratch.qpos[model.jnt_qposadr[limited]] = model.jnt_range[limited, number - 1]
        if number > 2:
            scratch.qpos[model.jnt_qposadr[arms]] = generator.uniform(low, high)
        mujoco.mj_kinematics(model, scratch)
        turned = scratch.geom_xmat[geoms].reshape(-1, 3, 3)
        boxes = model.geom_aabb[geoms, None, :3] + hulls * model.geom_aabb[geoms, None, 3:]
        found.append(boxes @ turned.transpose(0, 2, 1) + scratch.geom_xpos[geoms, None])
    return np.concatenate(found).reshape(-1, 3)


def _drives(model: mujoco.MjModel) -> np.ndarray:
    """Whether a joint is moved by an actuator, ``(njnt,)``."""
    joints = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    return np.isin(np.arange(model.njnt), model.actuator_trnid[joints, 0])


def beside(model: mujoco.MjModel, points: np.ndarray) -> list[Part]:
    """Return the scale on the floor; nothing without a floor."""
    height = floor(model)
    return [] if height is None else scale(points.min(axis=0), points.max(axis=0), height)


def floor(model: mujoco.MjModel) -> float | None:
    """Return the height of the first plane (m); None without a plane."""
    planes = np.flatnonzero(model.geom_type == FLOORS[0])
    return float(model.geom_pos[planes[0], 2]) if len(planes) else None


def corners(part: Part) -> np.ndarray:
    """Return the corners of a box in world coordinates, ``(8, 3)`` (m)."""
    return np.array(part.place) + CORNERS * np.array(part.size)
