"""The emulated CiA 402 drive: the block diagram of a servo drive, one box a file.

encoder -> device_control -> modes -> limits -> cascade -> torque      cycle.py has the order
   probe      |  stop, brake     ramps, homing     thermal, dc_link, monitor, sync, faults
              inverter: the contacts that start a frequency inverter instead of a master

record.py holds every quantity, factors.py converts units, statusword.py says how it went.
model.py reads what makes a drive the one it is, rows.py its files; drive.py is the face, and
parameters.py what it keeps. A master has two doors: objects.py, with hooks/ for what an object does
beside moving bytes, and process_data.py. canopen/ and ethercat.py put them on a bus.
"""

from .abort import Abort, SdoAbort
from .drive import Drive
from .model import DriveModel

__all__ = ["Abort", "Drive", "DriveModel", "SdoAbort"]
