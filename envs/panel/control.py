"""Control: one seat, and a token for each tab of the browser.

A stop needs no seat. Who has the seat shows with each picture that it is still there; a window that
is silent for `LOST` seconds, because it was closed, cut off or stands still, has lost what it had
set in motion: the clock stops it.
"""

LOST = 3.0  # s of silence; a reload takes less


class NotInControl(ValueError):
    """A tab that only watches has sent a command."""


class Control:
    """The seat of the commander. A tab is identified by any unique text."""

    def __init__(self) -> None:
        self.holder: str | None = None
        self.takeovers = 0
        self.window = ""  # that has sent the present request
        self.named: dict[str, str] = {}  # by tab
        self._seen: float | None = None  # when the holder was there last (s); None: it never says

    def name(self, tab: str) -> str:
        """The name of a tab in the log."""
        return self.named.setdefault(tab, f"window {len(self.named) + 1}")

    def take(self, tab: str) -> None:
        """Take the seat; its former holder only watches from now on."""
        if self.holder not in (None, tab):
            self.takeovers += 1
        if self.holder != tab:
            self._seen = None
        self.holder = tab

    def leave(self, tab: str) -> None:
        """Release the seat, if this tab holds it."""
        if self.holder == tab:
            self.holder, self._seen = None, None

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
            self._seen = now

    def lost(self, now: float) -> bool:
        """Whether the holder was silent for too long; reported once."""
        if self._seen is None or now - self._seen < LOST:
            return False
        self._seen = None
        return True
