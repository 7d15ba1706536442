"""The tasks: one file an environment, the docstring of its class is its page."""

from .commissioning import CommissioningEnv
from .compliant import CompliantAxisEnv
from .contour import GantryContourEnv
from .gantry_sync import GantrySyncEnv
from .homing import HomingEnv
from .positioning import LinearAxisEnv
from .robot import RobotEnv
from .rotary import RotaryAxisEnv
from .sway import GantrySwayEnv
from .tracking import LinearAxisTrackingEnv

TASKS = (
    LinearAxisEnv, LinearAxisTrackingEnv, RotaryAxisEnv, CompliantAxisEnv, HomingEnv,
    CommissioningEnv, GantrySyncEnv, GantryContourEnv, GantrySwayEnv,
)
ON_MODELS = (RobotEnv,)  # their machine is an argument
POINT_TO_POINT = LinearAxisEnv  # what speed and positioning are measured with
SWINGING_LOAD = CompliantAxisEnv  # the same with a sensor at a load on a spring
