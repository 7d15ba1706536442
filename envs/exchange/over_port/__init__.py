"""The drives of an environment on a bus: the same process images, in real time, behind a guard.

>>> bus = can.Bus(interface="socketcan", channel="can0", bitrate=1_000_000)
>>> env = gymnasium.make("servogym/LinearAxis-v0", port=CanDrives(CanPort(bus), {"x": 1}))

Each step of an agent is one period of the bus, scheduled by absolute times::

    t            t + phase                          t + period
    | ask, answers, policy | set-points go out ...  | ask, ...

Set-points are sent at the same phase of every step, even if the policy answers earlier. A drive
interpolates from one set-point to the next, so a late set-point causes a position error of velocity
times delay. RPDOs take effect on arrival, and TPDOs answer the SYNC that this side sends. On
EtherCAT one process-data frame carries the outputs and another reads the inputs, so reading does
not count as a new set-point.

Quantities that a bus does not transmit are derived from those it does: the load is taken to be
where the encoder reports it, and the share of a step spent at an internal limit is the state of the
limit at its end. The environment's machine does not advance in time. It only stores what the task
reads.

A drive that has to begin an episode without a reference, as in ``Homing-v0``, is first homed by the
master with the method that the task imitates. This gives the start and the true home as the encoder
and that method see them. An interrupted homing then removes the drive's reference (6041h, mode hm).
When the drive takes a new reference its position jumps, and the master continues to count from the
old one. The home found is known to within the mean of two velocities. The energy of an impact on an
end stop is not transmitted and counts as zero.
"""

from .can_drives import CanDrives
from .ethercat_drives import EtherCatDrives
from .line import PortLine, steps_bridged
from .pace import LOCK_STEP_PATIENCE, LockStep, Pace
from .side import DriveSide, Limits

__all__ = [
    "LOCK_STEP_PATIENCE", "CanDrives", "DriveSide", "EtherCatDrives", "Limits", "LockStep", "Pace",
    "PortLine", "steps_bridged",
]
