"""Explains LSS frames, by which a master assigns node-ids and bit rates (CiA 305)."""

import struct

from ..frame import Frame

REQUEST, RESPONSE = 0x7E5, 0x7E4
ADDRESS = {64: "vendor_id", 65: "product_code", 66: "revision_number", 67: "serial_number"}
IDENTIFY = {70: "vendor_id", 71: "product_code", 72: "revision_low", 73: "revision_high",
            74: "serial_low", 75: "serial_high"}
INQUIRE = {90: "vendor_id", 91: "product_code", 92: "revision_number", 93: "serial_number"}
RESULT = ("<BB", ("error", "specific"))
LSS = {  # command specifier -> name, and the fields behind it
    REQUEST: {
        4: ("switch state global", "<B", ("mode",)),
        17: ("configure node-id", "<B", ("node_id",)),
        19: ("configure bit timing", "<BB", ("table", "entry")),
        21: ("activate bit timing", "<H", ("delay",)),
        23: ("store configuration", "<", ()),
        76: ("identify non-configured", "<", ()),
        81: ("fast scan", "<IBBB", ("id_number", "bit_check", "lss_sub", "lss_next")),
        94: ("inquire node-id", "<", ()),
        **{cs: ("switch state selective", "<I", (name,)) for cs, name in ADDRESS.items()},
        **{cs: ("identify", "<I", (name,)) for cs, name in IDENTIFY.items()},
        **{cs: (f"inquire {name}", "<", ()) for cs, name in INQUIRE.items()},
    },
    RESPONSE: {
        17: ("configure node-id", *RESULT),
        19: ("configure bit timing", *RESULT),
        23: ("store configuration", *RESULT),
        68: ("state switched", "<", ()),
        79: ("identified", "<", ()),
        80: ("non-configured identified", "<", ()),
        94: ("node-id", "<B", ("node_id",)),
        **{cs: ("identity", "<I", (name,)) for cs, name in INQUIRE.items()},
    },
}


def tell(frame: Frame) -> str | None:
    """Explain an LSS frame in one line; None if CiA 305 does not define it."""
    if frame.remote or len(frame.data) != 8:
        return None
    service = LSS[frame.id].get(frame.data[0])
    if service is None:
        return None
    name, format_, fields = service
    values = struct.unpack_from(format_, frame.data, 1)
    pairs = (f"{k}={v:08X}h" if v > 0xFFFF else f"{k}={v}"
             for k, v in zip(fields, values, strict=True))
    return " ".join(["LSS", name, *pairs])
