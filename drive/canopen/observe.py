"""Observes a drive on CANopen by queries: see `servogym.drive.observation`."""

import struct
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ..drive import Drive
from ..machine import Standing
from ..master.errors import Timeout
from ..model.model import DriveModel, load
from ..objects.abort import Abort, SdoAbort
from ..observation import ASKED, SETTLED, danger, shown
from ..observation import Observer as _Observer
from .frame import Base, Frame
from .node import Node
from .port import FramePort, NodePort
from .sdo_client import SdoClient

LISTENED = 0.3  # s, for other nodes
PROTOCOL = {  # requests without an object, as CiA 301 answers or refuses them
    "unknown command specifier": ("E041600000000000",),
    "segment of no upload": ("6000000000000000",),
    "segment of no download": ("0000000000000000",),
    "end of no block download": ("C100000000000000",),
    "start of no block upload": ("A300000000000000",),
    "block upload of 0 segments": ("A041600000000000",),
    "block upload of 128 segments": ("A041600080000000",),
    "block download of a read-only object": ("C241600002000000",),
    "an object that there is not": ("40FF5F0000000000",),
    "segmented upload, toggle wrong": ("4008100000000000", "7000000000000000"),
    "segmented download refused at the start": ("2141600002000000",),
}


def of_model(
    model: "str | DriveModel | Any", node_id: int = 1, like: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Observe a model through a node in this process. Raises ValueError as `load`.

    Args:
        model: its name, its folder, or itself.
        node_id: 1..127.
        like: an observation of a drive to compare with, see `Observer`.
    """
    drive = Drive(load(model, "can"), node_id=node_id)
    period = float(drive.model.cycle_time["position"])
    port = NodePort(Standing({"x": drive}, period), Node(drive))
    return Observer(port, node_id, drive.model, like=like).observe()


class Observer(_Observer):
    """Queries one node.

    Args:
        bus: the way to it.
        node_id: 1..127.
        model: whose data types the objects have, where their lengths agree.
        read_only: write nothing.
        timeout: for an answer (s).
        tell: takes a line of progress.
        like: an observation to compare with, whose data types come first.

    `observe` raises `Timeout` where the node does not answer.
    """

    def __init__(
        self, bus: FramePort, node_id: int, model: "str | DriveModel" = "generic", *,
        read_only: bool = False, timeout: float = 0.5,
        tell: Callable[[str], None] = lambda text: None, like: Mapping[str, Any] | None = None,
    ):
        line = CanLine(bus, node_id, timeout)
        super().__init__(line, model, read_only=read_only, tell=tell, like=like)


class CanLine:
    """The connection to a node."""

    def __init__(self, bus: FramePort, node_id: int, timeout: float):
        self.about = {"bus": "can", "node_id": node_id}
        self._bus, self._node_id, self._timeout = bus, node_id, timeout
        self._sdo = SdoClient(bus, node_id, timeout)
        self.upload, self.download = self._sdo.upload, self._sdo.download

    def wait(self, time: float) -> list[Frame]:
        """Wait for a time (s); -> the frames received."""
        end = self._bus.now() + time
        heard: list[Frame] = []
        while self._bus.now() < end:
            heard += self._bus.exchange([])
        return heard

    def why_not_write(self) -> str:
        """A node that is enabled or moves, this one or another that is heard."""
        heard = self.wait(LISTENED)
        others = {frame.id & 0x7F for frame in heard if frame.id >= 0x180} - {0, self._node_id}
        for node_id in (self._node_id, *sorted(others)):
            sdo = SdoClient(self._bus, node_id, self._timeout, attempts=1)
            try:
                if found := danger(sdo.upload, self.wait):
                    return f"node {node_id} {found}"
            except (SdoAbort, Timeout):
                continue  # no drive, or one without a position
        return ""

    def indices(self, block: range) -> Iterable[int]:
        """All objects, because a node has no list of them."""
        return block

    def _raw(self, request: bytes) -> str:
        """The answer to a raw request, "" without an answer."""
        end = self._bus.now() + SETTLED
        frames = [Frame(Base.SDO_REQUEST + self._node_id, request)]
        while True:
            for frame in self._bus.exchange(frames):
                if frame.id == Base.SDO_RESPONSE + self._node_id:
                    return frame.data.hex()
            frames = []
            if self._bus.now() >= end:
                return ""

    def ask(self, values: Mapping[tuple[int, int], str]) -> dict[str, list[str]]:
        """SDO against its protocol, sub-indices and lengths that there are not, node guarding."""
        found: dict[str, list[str]] = {}
        for name, requests in PROTOCOL.items():
            found[name] = [self._raw(bytes.fromhex(request)) for request in requests][-1:]
            self._abort()
        for address in ASKED:
            if address not in values:
                continue
            name, head = shown(address), struct.pack("<H", address[0])
            found[f"{name} sub-index FEh"] = [self._raw(b"\x40" + head + b"\xfe" + bytes(4))]
            size = len(values[address]) // 2
            if values[address].startswith("abort") or not 1 <= size <= 4:
                continue
            target = head + bytes([address[1]])
            # a length that the object does not have is refused before anything is stored
            too_long = b"\x21" + target + struct.pack("<I", size + 4)
            found[f"{name} {size + 4} bytes"] = [self._raw(too_long)]
            self._abort()
            if size > 1:
                short = bytes([0x23 | (4 - size + 1) << 2]) + target + bytes(4)
                found[f"{name} {size - 1} bytes"] = [self._raw(short)]
        if _guards(values):
            found["node guarding"] = ["not asked: the drive would expect it from then on"]
            return found
        rtr = Frame(Base.ERROR_CONTROL + self._node_id, remote=True)
        guarded = self._bus.exchange([rtr])
        found["node guarding"] = [
            frame.data.hex() for frame in [*guarded, *self.wait(SETTLED)]
            if frame.id == rtr.id and not frame.remote
        ][:1]
        return found

    def _abort(self) -> None:
        """End a transfer that may be open."""
        data = b"\x80" + bytes(3) + struct.pack("<I", Abort.GENERAL)
        self._bus.exchange([Frame(Base.SDO_REQUEST + self._node_id, data)])


def _guards(values: Mapping[tuple[int, int], str]) -> bool:
    """Whether a node monitors its master from the first guarding frame on (CiA 301, 7.2.8.3.2.1).

    A node with a guard time (100Ch) and a life time factor (100Dh) takes the end of guarding for a
    lost master, and stops its drive.
    """
    return all(values.get((index, 0), "00").strip("0") for index in (0x100C, 0x100D))
