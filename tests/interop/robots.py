"""Foreign robots under our drives: which of them move, and what stops the others.

    python tests/interop/robots.py FOLDER ... > table.md

A folder holds packages that bring MJCF: dm_control, robosuite, gymnasium_robotics, metaworld;
unpacked wheels will do; Gymnasium's own robots are taken as well. Each joint with an actuator
(without any: each hinge and slide) gets a drive with the gears of `from_mjcf`, is commissioned,
enabled and homed where it stands, and moves 5 % of its range and back, one after the other.
"""

import sys
from pathlib import Path

import gymnasium
import mujoco
import numpy as np

from servogym.drive.master import Master, ServoError
from servogym.envs import Machine, commission_joint
from servogym.envs.engine.mjcf_reading import read
from servogym.envs.masters.port import MachinePort

FOUND = (  # of each package
    "dm_control/suite/*.xml",
    "robosuite/models/assets/robots/*/robot.xml",
    "gymnasium_robotics/envs/assets/fetch/reach.xml",
    "gymnasium_robotics/envs/assets/hand/reach.xml",
    "gymnasium_robotics/envs/assets/point/point.xml",
    "gymnasium_robotics/envs/assets/kitchen_franka/kitchen_assets/kitchen_env_model.xml",
    "gymnasium_robotics/envs/assets/adroit_hand/adroit_[dhpr]*.xml",
    "metaworld/assets/sawyer_xyz/sawyer_reach_v*.xml",
)
JOINTS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
LOCKED = 1e6  # N·s/m or Nm·s/rad: the base of fetch is held by a damping of 1e11
MOST = 6  # joints of a robot that move; all hold
SHARE, FREE = 0.05, 0.1  # of the range, and rad or m where there is none


def robots(folders):
    """Files, the packages' own paths in front."""
    own = Path(gymnasium.__file__).parent / "envs/mujoco/assets"
    yield from (("gymnasium", file, own) for file in sorted(own.glob("*.xml")))
    for folder in map(Path, folders):
        for pattern in FOUND:
            package = pattern.partition("/")[0]
            for file in sorted(folder.glob(pattern)):
                yield package, file, folder / package


def driven(spec):
    """Names of the joints that get drives."""
    joints = {
        j.name: j for j in spec.joints if j.type in JOINTS and j.name and np.max(j.damping) < LOCKED
    }
    acting = [a.target for a in spec.actuators if a.target in joints]
    once = [name for name in dict.fromkeys(acting) if acting.count(name) == 1]
    return once or list(joints)


def attempt(file, folder):
    """How many joints moved, of how many; and what stopped one."""
    names = driven(read(file, folder))
    if not names:
        return 0, 0, "no joint a drive could be on"
    machine = Machine.from_mjcf(file, dict.fromkeys(names, "generic"), folder=folder)
    rest = {}
    for i, name in enumerate(names):  # a zero may be out of the range
        here = float(machine.data.qpos[machine.couplings[i].qpos])
        low, high = machine.mechanics["low"][i], machine.mechanics["high"][i]
        rest[name] = float(np.clip(here, low + (high - low) * 1e-3 if low > -np.inf else low, high))
    machine.reset(positions=rest)
    for name in names:
        commission_joint(machine, name)
    port = MachinePort(machine)
    Master(port, *names).enable()
    Master(port, *names).home()
    moved, chosen = 0, names[:MOST]
    for name in chosen:
        joint = machine.model.joint(name)
        low, high = joint.range if joint.limited[0] else (-FREE / SHARE, 0.0)
        here = float(machine.data.joint(name).qpos[0])
        way = SHARE * (high - low) * (1.0 if here < (low + high) / 2 else -1.0)
        try:
            Master(port, name).move_to(here + way, timeout=5.0)
            Master(port, name).move_to(here + 0.1 * way, timeout=5.0)
        except ServoError as error:
            return moved, len(chosen), f"{name}: {error}"
        moved += 1
    return moved, len(chosen), ""


def main(folders):
    print("| robot | joints moved | what stopped it |\n|---|---|---|")
    whole = contact = force = neither = 0
    for package, file, folder in robots(folders):
        try:
            moved, of, why = attempt(file, folder)
        except (ValueError, RuntimeError, TimeoutError) as error:
            moved, of, why = 0, 0, str(error)
        if of and moved == of:
            whole += 1
        elif " touches " in why:
            contact += 1
        elif " takes " in why or not of:
            force += 1
        else:
            neither += 1
        why = " ".join(why.replace(str(folder), "").split())[:300]
        print(f"| {package}/{file.parent.name}/{file.name} | {moved} of {of} | {why} |", flush=True)
    print(
        f"\n{whole + contact + force + neither} robots: {whole} move, {contact} name the contact"
        f" that stops them, {force} another reason, {neither} none"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
