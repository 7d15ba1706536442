"""servogym: a laboratory for motion control. Its rooms: drive, envs, assets, training."""

from importlib.metadata import version

__version__ = version("servogym")
