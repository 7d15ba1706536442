"""How the master brings drives on a bus to where an episode begins."""

import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import NamedTuple

from ....drive.kernel.words import ENABLED, Mode
from ....drive.kernel.words import Controlword as C
from ....drive.kernel.words import Statusword as S
from ....drive.master.master import Master
from ....drive.objects.abort import SdoAbort
from .mirror import REFERENCED
from .pace import LOCK_STEP_PATIENCE
from .settings import Settings
from .side import DriveSide

PROFILE = ("profile_velocity", "profile_acceleration", "profile_deceleration")
APPROACH = 0.4  # share of these on the way to the start: the gains may be set for slower motion
REST = 0.3  # s that an axis stands before an episode, in which its integrator settles
NEAR = 1e-5  # m or rad from the start within which no motion is needed
SEARCH_TIME_OUT = 300.0  # s for a homing, which may search slowly from end to end
FORGET_TIME_OUT = 5.0  # s until an interrupted homing stands


class Search(NamedTuple):
    """A homing before each episode, after which the drives lose their reference again."""

    method: int  # 6098h
    home: float  # where the task has its home (m or rad)


class Start:
    """Enables the drives, homes them and moves them to their starts.

    Args:
        master: of the drives.
        side: the bus of the drives.
        settings: by which objects are changed.
        commanded: names of the objects in the RPDOs of the task.
        units: position units per m or rad.
        period: of the agent's steps (s).
    """

    def __init__(
        self, master: Master, side: DriveSide, settings: Settings, commanded: Collection[str],
        units: float, period: float,
    ):
        self._master, self._side, self._settings = master, side, settings
        self._commanded, self._units, self._period = commanded, units, period

    def check_referenced(self) -> None:
        """Raise ValueError for a drive without a reference."""
        self._master.set_mode(Mode.HOMING)
        for axis in self._master.axes:
            if not int(self._side.port.upload(axis, "statusword")) & REFERENCED:
                raise ValueError(
                    f"{axis} is not referenced: home it with --home METHOD (6098h), once"
                )

    def prepare(self, search: Search) -> None:
        """Set where a search finds the home. Raises ValueError for a drive without its method."""
        for axis in self._master.axes:
            model = self._side.port.models[axis]
            if search.method not in model.homing_methods:
                raise ValueError(
                    f"{axis}: drive {model.name!r} does not have the homing method {search.method} "
                    "by which the task knows its true home"
                )
            self._settings.set(axis, "home_offset", -round(search.home * self._units))

    def go(
        self, positions: Mapping[str, float], mode: Mode, search: Search | None, home: int | None
    ) -> None:
        """Enable the drives and bring them to rest where an episode begins.

        Args:
            positions: of the drives (m or rad).
            mode: of the episode.
            search: homes the drives and removes the reference again.
            home: method (6098h) that homes the drives for good.

        Raises:
            ServoError, SdoAbort, TimeoutError: a drive does not follow.
        """
        master, port = self._master, self._side.port
        master.reset_fault()  # a fault of a lost connection is over; a lasting one is reported
        self._settings.restore("max_torque")  # an agent may have left its own
        master.enable()
        if search is not None:
            for axis in master.axes:
                self._settings.set(axis, "homing_method", search.method)
            master.home(timeout=SEARCH_TIME_OUT)
        elif home is not None:
            master.home(home)
        wanted = {axis: round(place * self._units) for axis, place in positions.items()}
        if any(abs(self.position(axis) - wanted[axis]) > NEAR * self._units for axis in wanted):
            master.set_mode(Mode.PROFILE_POSITION)
            with self._gently():
                master.move_to(wanted)
        if search is not None:
            self._forget()
        for axis in master.axes:
            if "max_torque" in self._commanded:
                self._settings.set(axis, "max_torque", port.upload(axis, "max_torque"))
            for name in ("target_position", "target_velocity", "target_torque"):
                if name in self._commanded:
                    value = self.position(axis) if name == "target_position" else 0
                    port.write(axis, name, value)
        master.set_mode(mode)
        self._rest()

    def position(self, axis: str) -> int:
        """Return the position of a drive (drive units)."""
        return int(self._side.port.upload(axis, "position_actual_value"))

    def _rest(self) -> None:
        """Exchange process data at the agent's rate while the axes settle."""
        pace = self._side.pace
        deadline = pace.now()
        for _ in range(math.ceil(REST / self._period)):
            deadline += self._period
            pace.wait(deadline)
            self._side.send()
            self._side.sample(self._period if pace.real else LOCK_STEP_PATIENCE)

    def _forget(self) -> None:
        """Start a homing and interrupt it, which removes the reference (CiA 402-2, hm)."""
        master = self._master
        master.set_mode(Mode.HOMING)
        master.control(ENABLED | C.NEW_SET_POINT)
        master.control(ENABLED)
        master.wait_until(
            lambda word: bool(word & S.TARGET_REACHED and not word & REFERENCED), FORGET_TIME_OUT,
            "an interrupted homing takes the reference away",
        )
        for axis in master.axes:
            here = self._side.port.models[axis].homes_here
            self._settings.set(axis, "homing_method", here)

    @contextmanager
    def _gently(self) -> Iterator[None]:
        """Reduce velocity and accelerations of the profile for the duration of the context."""
        for axis in self._master.axes:
            for name in PROFILE:
                with suppress(SdoAbort, ValueError):
                    value = self._side.port.upload(axis, name)
                    self._settings.set(axis, name, max(round(APPROACH * value), 1))
        yield
        self._settings.restore(*PROFILE)
