"""Explains LSS frames, by which a master assigns node-ids and bit rates (CiA 305)."""

import struct

from ..frame import Base, Frame
from ..lss import Command

IDENTITY = ("vendor_id", "product_code", "revision_number", "serial_number")
RANGES = (*IDENTITY[:2], "revision_low", "revision_high", "serial_low", "serial_high")
RESULT = ("<BB", ("error", "specific"))
LSS = {  # command specifier -> name, format and names of the fields behind it
    Base.LSS_REQUEST: {
        Command.SWITCH_GLOBAL: ("switch state global", "<B", ("mode",)),
        Command.CONFIGURE_NODE_ID: ("configure node-id", "<B", ("node_id",)),
        Command.CONFIGURE_BIT_TIMING: ("configure bit timing", "<BB", ("table", "entry")),
        Command.ACTIVATE_BIT_TIMING: ("activate bit timing", "<H", ("delay",)),
        Command.STORE: ("store configuration", "<", ()),
        Command.IDENTIFY_NON_CONFIGURED: ("identify non-configured", "<", ()),
        Command.FASTSCAN: ("fast scan", "<IBBB", ("id_number", "bit_check", "lss_sub", "lss_next")),
        Command.INQUIRE_NODE_ID: ("inquire node-id", "<", ()),
        **{Command.SWITCH_SELECTIVE + n: ("switch state selective", "<I", (name,))
           for n, name in enumerate(IDENTITY)},
        **{Command.IDENTIFY_REMOTE + n: ("identify", "<I", (name,))
           for n, name in enumerate(RANGES)},
        **{Command.INQUIRE_IDENTITY + n: (f"inquire {name}", "<", ())
           for n, name in enumerate(IDENTITY)},
    },
    Base.LSS_RESPONSE: {
        Command.CONFIGURE_NODE_ID: ("configure node-id", *RESULT),
        Command.CONFIGURE_BIT_TIMING: ("configure bit timing", *RESULT),
        Command.STORE: ("store configuration", *RESULT),
        Command.SELECTED: ("state switched", "<", ()),
        Command.IDENTIFIED: ("identified", "<", ()),
        Command.NON_CONFIGURED: ("non-configured identified", "<", ()),
        Command.INQUIRE_NODE_ID: ("node-id", "<B", ("node_id",)),
        **{Command.INQUIRE_IDENTITY + n: ("identity", "<I", (name,))
           for n, name in enumerate(IDENTITY)},
    },
}


def explain(frame: Frame) -> str | None:
    """Explain an LSS frame in one line; None if CiA 305 does not define it."""
    if frame.remote or len(frame.data) != 8:
        return None
    service = LSS[Base(frame.id)].get(frame.data[0])
    if service is None:
        return None
    name, format_, fields = service
    values = struct.unpack_from(format_, frame.data, 1)
    pairs = (f"{k}={v:08X}h" if v > 0xFFFF else f"{k}={v}"
             for k, v in zip(fields, values, strict=True))
    return " ".join(["LSS", name, *pairs])
