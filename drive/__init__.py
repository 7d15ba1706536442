"""The emulated CiA 402 drive: the block diagram of a servo drive, one box a file.

encoder -> device_control -> modes -> limits -> cascade -> torque      cycle.py has the order
              |  stop, brake     ramps, homing     thermal, dc_link, monitor, faults

record.py holds every quantity, factors.py converts units, objects.py and process_data.py are the
two doors for a master, model.py reads what makes a drive the one it is, drive.py is the face.
"""

from .abort import Abort, SdoAbort
from .drive import Drive
from .model import DriveModel

__all__ = ["Abort", "Drive", "DriveModel", "SdoAbort"]
