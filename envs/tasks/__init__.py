"""The tasks: one file per environment; the docstring of its class is its page."""

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
ON_MODELS = (RobotEnv,)  # tasks whose machine is an argument
POINT_TO_POINT = LinearAxisEnv  # the task for benchmarks of speed and positioning
SWINGING_LOAD = CompliantAxisEnv  # the same with a load on a spring and a sensor there
