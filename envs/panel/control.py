"""Control: one seat for the tab that commands, and a name for each tab.

A stop needs no seat. The tab in the seat confirms each picture. If it is silent for `LOST` seconds
because it was closed, cut off or frozen, the clock stops the motions that it has started.
"""

LOST = 3.0  # s of silence; a reload takes less


class NotInControl(ValueError):
    """A tab that only watches has sent a command."""


class Control:
    """The seat of the commander. A tab is identified by any unique text."""

    def __init__(self) -> None:
        self.holder: str | None = None
        self.window = ""  # name of the tab that has sent the present request
        self.named: dict[str, str] = {}  # names by tab
        self._alive: float | None = None  # time of the holder's last beat (s), if any

    def name(self, tab: str) -> str:
        """The name of a tab in the log."""
        return self.named.setdefault(tab, f"window {len(self.named) + 1}")

    def take(self, tab: str) -> None:
        """Take the seat; its former holder only watches from now on."""
        if self.holder != tab:
            self._alive = None
        self.holder = tab

    def leave(self, tab: str) -> None:
        """Release the seat, if this tab holds it."""
        if self.holder == tab:
            self.holder, self._alive = None, None

    def holds(self, tab: str) -> bool:
        """Whether this tab commands."""
        return self.holder == tab

    def check(self, tab: str) -> None:
        """Raise NotInControl for a tab that only watches."""
        if not self.holds(tab):
            seat = "another window has control" if self.holder else "nobody has control"
            raise NotInControl(f"{seat}: press Take control first")

    def beat(self, tab: str, now: float) -> None:
        """Note that a tab is alive at `now` (s)."""
        if self.holder == tab:
            self._alive = now

    def lost(self, now: float) -> bool:
        """Whether the holder was silent for too long; reported once."""
        if self._alive is None or now - self._alive < LOST:
            return False
        self._alive = None
        return True
