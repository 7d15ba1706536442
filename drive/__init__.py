"""The emulated CiA 402 drive: the block diagram of a servo drive, one box a file.

kernel/  encoder -> device_control -> modes -> limits -> cascade -> torque   cycle.py has the order
            probe      |  stop, brake    ramps, homing    thermal, dc_link, monitor, sync, faults
                       contacts: what starts a frequency inverter instead of a master
         record/ holds every quantity, factors.py converts units, statusword.py says how it went.
model/   what makes a drive the one it is: a folder of files.
objects/ the first door of a master: the dictionary, its hooks, what is stored. The second one is
         process data. drive.py is the face of both.
master/  who commands drives, on any bus: one class over ports.
canopen/ and ethercat/ put them on a bus, in bytes and given time; wire/ has clock and sockets.
"""

from .drive import Drive
from .kernel.modes.own import ModeOfOperation
from .model.model import DriveModel
from .model.plugins import run_code
from .objects.abort import Abort, SdoAbort
from .objects.hooks import Hook

__all__ = ["Abort", "Drive", "DriveModel", "Hook", "ModeOfOperation", "SdoAbort", "run_code"]
