"""servogym: a laboratory for motion control. Its rooms: drive, envs, assets, training."""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

if not Path(__file__).parent.is_dir():
    raise ImportError(f"{__file__}: servogym has files beside its modules, unpack or install it")

try:
    __version__ = version("servogym")
except PackageNotFoundError:  # a checkout on the path that is not installed
    __version__ = "unknown"
