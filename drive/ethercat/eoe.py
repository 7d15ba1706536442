"""Ethernet over EtherCAT: the address is accepted and announced; there are no services behind it.

Source: ETG.1000.6, 5.7. The first word of a telegram contains the type and the last-fragment bit.
The second word of a fragment contains fragment number, size and frame number; the second word of a
response contains the result. A real drive was observed to announce its address by ARP; the frame
follows RFC 5227 (inferred).
"""

import struct

from .mailbox import Answer, MailboxError

TYPE, LAST = 0x000F, 0x0100
FRAME, SET_IP, SET_IP_RESPONSE = 0, 2, 3
SUCCESS = 0x0000
WITH_MAC, WITH_IP = 0x01, 0x02  # flags at the beginning of the parameters
ARP = struct.Struct("!HHBBH6s4s6s4s")
ETHERNET, IPV4, REQUEST, ARP_TYPE = 1, 0x0800, 1, 0x0806
SHORTEST = 60  # bytes of an Ethernet frame without its check sequence
BLOCK = 32  # bytes: the unit of the size in the header


def request(body: bytes, size: int) -> Answer:
    """Answer Set IP; `size` is the longest body of an answer (bytes)."""
    if int.from_bytes(body[:2], "little") & TYPE != SET_IP:
        return MailboxError.SERVICE_NOT_SUPPORTED
    answers = [struct.pack("<HH", SET_IP_RESPONSE, SUCCESS)]
    announcement = announced(body[4:])
    if announcement and 4 + len(announcement) <= size:
        blocks = -(-len(announcement) // BLOCK)
        answers.append(struct.pack("<HH", FRAME | LAST, blocks << 6) + announcement)
    return answers


def announced(parameters: bytes) -> bytes:
    """The ARP frame for the parameters of Set IP; empty without a MAC or an IP address."""
    flags = parameters[0] if parameters else 0
    if flags & (WITH_MAC | WITH_IP) != WITH_MAC | WITH_IP or len(parameters) < 14:
        return b""
    mac, address = parameters[4:10], parameters[13:9:-1]  # least significant byte first
    if not any(address):
        return b""
    head = b"\xff" * 6 + mac + struct.pack("!H", ARP_TYPE)
    arp = ARP.pack(ETHERNET, IPV4, 6, 4, REQUEST, mac, address, bytes(6), address)
    return (head + arp).ljust(SHORTEST, b"\0")
