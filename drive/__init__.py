"""The emulated CiA 402 drive: the block diagram of a servo drive, one file for each box.

kernel/  encoder -> device_control -> modes -> limits -> cascade -> torque   cycle.py has the order
            probe      |  stop, brake    ramps, homing    thermal, dc_link, monitor, sync, faults
                       contacts: what starts a frequency inverter instead of a master
         record/ holds every quantity, factors/ converts units, statusword.py reports the status.
model/   loads a drive model from its folder of files.
objects/ the object dictionary, its hooks, and stored parameters. drive.py joins it with the
         process data.
master/  commands drives on any bus: one class over ports.
canopen/ and ethercat/ serve drives on a bus, in bytes and given time; wire/ has clock and sockets.
"""

from .drive import Drive
from .kernel.modes.own import ModeOfOperation
from .model.model import DriveModel
from .model.plugins import run_code
from .objects.abort import Abort, SdoAbort
from .objects.hooks import Hook

__all__ = ["Abort", "Drive", "DriveModel", "Hook", "ModeOfOperation", "SdoAbort", "run_code"]
