"""Forward kinematics in compiled code: the position of a site from the coordinates alone.

Machines of a vector share one MjData, so its ``site_xpos`` may belong to another machine.
"""

import math

import mujoco
import numpy as np

from ...drive.kernel.jit import block

LONGEST = 64  # rows
OFFSET, TURN, SHIFT = range(3)  # kinds of rows
# columns: kind, number of the coordinate, its value in the MJCF, then place and quaternion of a
# body in its parent (OFFSET), or anchor and axis of a joint in its body
WIDTH = 10


def table(model: mujoco.MjModel, site: int) -> np.ndarray:
    """Return the kinematic chain from the world to a site, shape ``(LONGEST, WIDTH)``.

    Raises ValueError if the chain has a ball or free joint, or is too long.
    """
    bodies, body = [], int(model.site_bodyid[site])
    while body:
        bodies.append(body)
        body = int(model.body_parentid[body])
    rows: list[list[float]] = []
    for body in reversed(bodies):
        rows.append([OFFSET, 0, 0, *model.body_pos[body], *model.body_quat[body]])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            kind = int(model.jnt_type[joint])
            if kind not in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
                raise ValueError(
                    f"site {model.site(site).name!r} hangs on {model.joint(joint).name!r}, which "
                    "is a ball or free joint: choose a site on a robot with a fixed base"
                )
            coordinate = int(model.jnt_qposadr[joint])
            turns = kind == int(mujoco.mjtJoint.mjJNT_HINGE)
            rows.append(
                [TURN if turns else SHIFT, coordinate, model.qpos0[coordinate],
                 *model.jnt_pos[joint], *model.jnt_axis[joint], 0.0]
            )
    rows.append([OFFSET, 0, 0, *model.site_pos[site], *model.site_quat[site]])
    if len(rows) > LONGEST:
        raise ValueError(f"site {model.site(site).name!r} hangs on more than {LONGEST} links")
    whole = np.zeros((LONGEST, WIDTH))
    whole[:, 0] = -1.0
    whole[: len(rows)] = rows
    return whole


@block
def place(rows, qpos, at):
    """Write the position (m) of the site of `table` at coordinates `qpos` into `at`."""
    x = y = z = 0.0
    a, b, c, d = 1.0, 0.0, 0.0, 0.0  # quaternion of the frame
    for i in range(LONGEST):
        kind = rows[i, 0]
        if kind < 0:
            break
        if kind == OFFSET:
            u, v, w = rows[i, 3], rows[i, 4], rows[i, 5]
            p, q, r, s = rows[i, 6], rows[i, 7], rows[i, 8], rows[i, 9]
        else:
            way = qpos[int(rows[i, 1])] - rows[i, 2]
            if kind == SHIFT:
                u, v, w = way * rows[i, 6], way * rows[i, 7], way * rows[i, 8]
                p, q, r, s = 1.0, 0.0, 0.0, 0.0
            else:  # turns about its anchor
                half, part = math.cos(0.5 * way), math.sin(0.5 * way)
                p, q, r, s = half, part * rows[i, 6], part * rows[i, 7], part * rows[i, 8]
                e, f, g = rows[i, 3], rows[i, 4], rows[i, 5]
                u, v, w = _turned(p, q, r, s, e, f, g)
                u, v, w = e - u, f - v, g - w
        dx, dy, dz = _turned(a, b, c, d, u, v, w)
        x, y, z = x + dx, y + dy, z + dz
        a, b, c, d = (
            a * p - b * q - c * r - d * s,
            a * q + b * p + c * s - d * r,
            a * r - b * s + c * p + d * q,
            a * s + b * r - c * q + d * p,
        )
    at[0], at[1], at[2] = x, y, z


@block
def _turned(a, b, c, d, x, y, z):
    """Rotate a vector by a quaternion."""
    u = 2.0 * (c * z - d * y)
    v = 2.0 * (d * x - b * z)
    w = 2.0 * (b * y - c * x)
    return x + a * u + c * w - d * v, y + a * v + d * u - b * w, z + a * w + b * v - c * u
