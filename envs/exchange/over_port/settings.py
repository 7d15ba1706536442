"""Objects of the drives that an environment changes while it uses them."""

from ....drive.master.port import Port


class Settings:
    """Writes objects of drives and restores them afterwards.

    Args:
        port: of the drives.
    """

    def __init__(self, port: Port):
        self._port = port
        self.changed: dict[tuple[str, str], float] = {}  # value before, by axis and object

    def set(self, axis: str, name: str, value: float) -> None:
        """Write an object of a drive until `restore`."""
        if (axis, name) not in self.changed:
            self.changed[axis, name] = self._port.upload(axis, name)
        self._port.write(axis, name, value)

    def restore(self, *names: str) -> None:
        """Write the previous values back, of these objects or, if none is named, of all."""
        for axis, name in [*self.changed]:
            if not names or name in names:
                self._port.write(axis, name, self.changed.pop((axis, name)))
