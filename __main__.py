"""The command ``servogym``, also ``python -m servogym``.

Ctrl-C while the commands are loaded ends at once: an exception could come out of any import,
through code of others that turns it into another one.
"""

import _signal as signal  # `signal` loads `enum` first, which takes longer than all else here
import os
import sys


def _leave(*_: object) -> None:
    os.write(2, b"interrupted\n")
    os._exit(130)


def main() -> int:
    """Load the commands and run one."""
    default = signal.getsignal(signal.SIGINT)
    if default is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)
    from .training.cli import main as run

    signal.signal(signal.SIGINT, default)
    return run()


if __name__ == "__main__":
    sys.exit(main())
