"""The clock that schedules the steps of an environment on a bus."""

import time

LOCK_STEP_PATIENCE = 10.0  # s to wait for an answer or an action where time stands still meanwhile


class Pace:
    """Real time. Steps end at absolute times, so delays do not accumulate."""

    real = True

    def now(self) -> float:
        """Return the present time (s) of a monotonic clock."""
        return time.monotonic()

    def wait(self, deadline: float) -> None:
        """Sleep until a time (s)."""
        left = deadline - time.monotonic()
        if left > 0.0:
            time.sleep(left)


class LockStep(Pace):
    """Time that advances with the steps, as fast as the served machines compute.

    The machines need a clock that waits for the bus: ``sync_end`` on CAN, ``frame`` on EtherCAT.
    See `servogym.envs.serve.description.BusRow`.
    """

    real = False

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        """Return the number of steps times their length (s)."""
        return self.time

    def wait(self, deadline: float) -> None:
        """Advance the time to a deadline (s)."""
        self.time = max(self.time, deadline)
