"""Who commands: one seat, and a token that each tab of the browser has for itself."""


class NotInControl(ValueError):
    """A command of a tab that only watches."""


class Control:
    """The seat of the commander. A tab is any text that is its own."""

    def __init__(self) -> None:
        self.holder: str | None = None
        self.takeovers = 0

    def take(self, tab: str) -> None:
        """Sit down; who sat there before watches from now on."""
        if self.holder not in (None, tab):
            self.takeovers += 1
        self.holder = tab

    def leave(self, tab: str) -> None:
        """Stand up, if it sits there."""
        if self.holder == tab:
            self.holder = None

    def holds(self, tab: str) -> bool:
        """Whether this tab commands."""
        return self.holder == tab

    def check(self, tab: str) -> None:
        """Raises NotInControl for a tab that only watches."""
        if not self.holds(tab):
            who = "another window has control" if self.holder else "nobody has control"
            raise NotInControl(f"{who}: press Take control first")
