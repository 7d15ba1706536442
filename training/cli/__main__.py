"""``python -m servogym.training.cli``."""

import sys

from . import main

sys.exit(main())
