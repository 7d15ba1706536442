"""The SDO servers of a node: the default one and those of 1201h… (CiA 301, SDO parameter)."""

from collections.abc import Callable

from ..drive import Drive
from ..objects.dictionary import indices
from .frame import Base, Route
from .sdo import SdoServer

INVALID = 0x8000_0000  # bit 31 of a COB-ID


class SdoServers:
    """The servers of a drive; `sender` returns the function that sends with an identifier."""

    def __init__(self, drive: Drive, sender: Callable[[int], Callable[[bytes], None]]):
        self._drive = drive
        self._sender = sender
        known = indices(drive.model)
        self._numbers = [0, *(n for n in range(1, 128) if 0x1200 + n in known)]

    def reset(self) -> None:
        """Drop all servers, as after a reset of the communication."""
        self.servers: dict[int, SdoServer] = {}

    def configure(self) -> None:
        """Read 1201h…; the identifiers of the default server follow from the node-id."""
        before, self.servers = self.servers, {}
        self.routes: list[Route] = []
        for number in self._numbers:
            request, response = self._identifiers(number)
            if (request | response) & INVALID:
                continue
            server = before.get(number) or SdoServer(self._drive.objects)
            server.send = self._sender(response & 0x7FF)
            self.servers[number] = server
            self.routes.append((request & 0x7FF, server.request))

    def _identifiers(self, number: int) -> tuple[int, int]:
        if number == 0:
            node_id = self._drive.node_id
            return Base.SDO_REQUEST + node_id, Base.SDO_RESPONSE + node_id
        value, index = self._drive.objects.value, 0x1200 + number
        return value(index, 1), value(index, 2)

    def stop(self) -> None:
        """End all transfers, as on entering STOPPED."""
        for server in self.servers.values():
            server.reset()
