"""Length of classical CAN frames in bit times, and their order of arbitration (ISO 11898-1).

Start of frame, arbitration field, control field, data and CRC are stuffed: after five equal bits
the sender inserts the opposite one. CRC delimiter, acknowledge and end of frame are not.
"""

from .frame import Frame

POLYNOMIAL = 0x4599  # CRC-15/CAN
FIXED = 1 + 2 + 7  # CRC delimiter, acknowledge slot and delimiter, end of frame
INTERFRAME_SPACE = 3
RUN = 5  # equal bits before a stuff bit


def crc15(bits: str) -> int:
    """CRC-15 of a sequence of the characters 0 and 1, most significant bit first."""
    crc = 0
    for bit in bits:
        crc <<= 1
        if (crc >> 15) ^ (bit == "1"):
            crc ^= POLYNOMIAL
        crc &= 0x7FFF
    return crc


def stuffed(frame: Frame) -> str:
    """The bits of `frame` that are subject to stuffing, CRC included, before stuffing."""
    remote = int(frame.remote)
    if frame.extended:  # substitute remote request and identifier extension are recessive
        low = frame.id & 0x3FFFF
        head = f"0{frame.id >> 18 & 0x7FF:011b}11{low:018b}{remote}00"
    else:
        head = f"0{frame.id & 0x7FF:011b}{remote}00"
    data = b"" if frame.remote else frame.data
    content = "".join((head, f"{len(frame.data):04b}", *(f"{byte:08b}" for byte in data)))
    return f"{content}{crc15(content):015b}"


def stuff_bits(bits: str) -> int:
    """Number of stuff bits that `bits` need; a stuff bit starts the next run."""
    added, run, last = 0, 0, ""
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == RUN:
            added += 1
            run, last = 1, "1" if bit == "0" else "0"
    return added


def length(frame: Frame) -> int:
    """Bit times from the start of a frame until the next may start, with the interframe space.

    A base frame with n data bytes has 47 + 8n bits and at most ⌊(33 + 8n) / 4⌋ stuff bits.
    """
    bits = stuffed(frame)
    return len(bits) + stuff_bits(bits) + FIXED + INTERFRAME_SPACE


def priority(frame: Frame) -> int:
    """The arbitration field as a number; the lowest one wins the arbitration.

    A data frame therefore precedes the remote frame of its identifier, and a base frame precedes
    the extended frame that begins with the same eleven bits.
    """
    if frame.extended:
        base, rest = divmod(frame.id, 1 << 18)
        return base << 21 | 0b11 << 19 | rest << 1 | frame.remote
    return frame.id << 21 | frame.remote << 20
