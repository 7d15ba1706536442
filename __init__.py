"""servogym: a laboratory for motion control. Its rooms: drive, envs, assets, training."""

import os

if not os.path.isdir(os.path.dirname(__file__)):
    raise ImportError(f"{__file__}: servogym has files beside its modules, unpack or install it")


def __getattr__(name: str) -> str:
    """``__version__``, looked up when it is asked for: that takes longer than all else here."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("servogym")
    except PackageNotFoundError:  # a checkout on the path that is not installed
        return "unknown"
