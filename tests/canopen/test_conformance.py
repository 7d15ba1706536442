"""CiA 301 behaviour as lists of frames: ``>`` to the node, ``<`` from it, ``+n`` n ms pass.

One test a list; the node has node-id 1 and is PRE-OPERATIONAL after its boot-up message.
"""

import binascii
import struct

import pytest
from conformance import OPERATIONAL, Bus, fuzz, read, refuse

from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.node import NmtState

NAME = "servogym generic CiA 402 drive"  # 1008h, 30 characters
CASES = {
    "nmt: start all": "> 000#0100\n< 181#5002",
    "nmt: start this node": "> 000#0101\n< 181#5002",
    "nmt: command to another node is ignored": "> 000#0102",
    "nmt: unknown command": "> 000#0501",
    "nmt: too short": "> 000#01",
    "nmt: too long": "> 000#010100",
    "nmt: reset node boots up": "> 000#8101\n< 701#00",
    "nmt: reset communication boots up": "> 000#8201\n< 701#00",
    "nmt: stopped has no sdo": "> 000#0201\n> 601#4041600000000000",
    "nmt: stopped has no pdo": OPERATIONAL + "> 000#0201\n> 201#0600\n+5",
    "nmt: back from stopped": "> 000#0201\n> 000#8001\n" + read(0x6041, 0, "4B41600050020000"),
    "nmt: pre-operational has no rpdo": "> 201#0600\n+2\n" + read(0x6040, 0, "4B40600000000000"),
    "sdo: expedited upload, 1 byte": read(0x1001, 0, "4F01100000000000"),
    "sdo: expedited upload, 2 bytes": read(0x6041, 0, "4B41600050020000"),
    "sdo: expedited upload, 4 bytes": read(0x1000, 0, "4300100092010200"),
    "sdo: upload of sub-index 0": read(0x1018, 0, "4F18100004000000"),
    "sdo: identity": read(0x1018, 2, "4318100202040000"),
    "sdo: expedited download, 1 byte": "> 601#2F60600001000000\n< 581#6060600000000000",
    "sdo: expedited download, 2 bytes": "> 601#2B40600006000000\n< 581#6040600000000000",
    "sdo: expedited download, 4 bytes": "> 601#237A600039300000\n< 581#607A600000000000",
    "sdo: expedited without size": "> 601#227A600039300000\n< 581#607A600000000000",
    "sdo: no such object": refuse("4000700000000000", 0x7000, 0, 0x06020000),
    "sdo: no such sub-index": refuse("407D600900000000", 0x607D, 9, 0x06090011),
    "sdo: write to ro": refuse("2B41600001000000", 0x6041, 0, 0x06010002),
    "sdo: write to const": refuse("2300100001000000", 0x1000, 0, 0x06010002),
    "sdo: too long": refuse("2340600001000000", 0x6040, 0, 0x06070012),
    "sdo: too short": refuse("2B7A600001000000", 0x607A, 0, 0x06070013),
    "sdo: too high": refuse("2B5A600009000000", 0x605A, 0, 0x06090031),
    "sdo: too low": refuse("2B5A6000FFFF0000", 0x605A, 0, 0x06090032),
    "sdo: invalid value": refuse("2F60600005000000", 0x6060, 0, 0x06090030),
    "sdo: wrong signature": refuse("2310100100000000", 0x1010, 1, 0x08000020),
    "sdo: store": "> 601#2310100173617665\n< 581#6010100100000000",
    "sdo: restore": "> 601#231110016C6F6164\n< 581#6011100100000000",
    "sdo: reserved command specifier": refuse("E041600000000000", 0x6041, 0, 0x05040001),
    "sdo: segment without a transfer": refuse("6041600000000000", 0x6041, 0, 0x05040001),
    "sdo: download segment without a transfer": refuse("0041600000000000", 0x6041, 0, 0x05040001),
    "sdo: block end without a transfer": refuse("C141600000000000", 0x6041, 0, 0x05040001),
    "sdo: abort of the client is not answered": "> 601#8041600000000000",
    "sdo: seven bytes are ignored": "> 601#40416000000000",
    "sdo: request to another node is ignored": "> 602#4041600000000000",
    "sdo: segmented download": """
        > 601#217A600004000000
        < 581#607A600000000000
        > 601#0739300000000000
        < 581#2000000000000000
        > 601#407A600000000000
        < 581#437A600039300000""",
    "sdo: segmented download of two segments, length wrong": """
        > 601#217A600008000000
        < 581#807A600012000706""",
    "sdo: segmented download of two segments without a length, wrong": """
        > 601#207A600000000000
        < 581#607A600000000000
        > 601#0001020304050607
        < 581#807A600012000706""",
    "sdo: segmented download, length too small": """
        > 601#217A600002000000
        < 581#807A600013000706""",
    "sdo: segmented download, toggle wrong": """
        > 601#217A600004000000
        < 581#607A600000000000
        > 601#1739300000000000
        < 581#807A600000000305""",
    "sdo: segmented download, announced and real length differ": """
        > 601#217A600004000000
        < 581#607A600000000000
        > 601#0539300000000000
        < 581#807A600010000706""",
    "sdo: segmented download refused at the start": refuse(
        "2141600002000000", 0x6041, 0, 0x06010002
    ),
    "sdo: segmented download, much too long": refuse("217A6000FFFFFFFF", 0x607A, 0, 0x06070012),
    "sdo: time-out": """
        > 601#217A600004000000
        < 581#607A600000000000
        +1002
        < 581#807A600000000405""",
    "sdo: a new request ends the old transfer": """
        > 601#4008100000000000
        < 581#410810001E000000
        > 601#4041600000000000
        < 581#4B41600050020000
        > 601#6000000000000000
        < 581#8000000001000405""",
    "sdo: upload toggle wrong": """
        > 601#4008100000000000
        < 581#410810001E000000
        > 601#7000000000000000
        < 581#8008100000000305""",
    "sdo: upload aborted by the client": """
        > 601#4008100000000000
        < 581#410810001E000000
        > 601#8008100000000008""",
    "sdo: block upload, block size 0": refuse("A408100000000000", 0x1008, 0, 0x05040002),
    "sdo: block upload, block size 128": refuse("A408100080000000", 0x1008, 0, 0x05040002),
    "sdo: block upload of a missing object": refuse("A400700010000000", 0x7000, 0, 0x06020000),
    "sdo: block download to ro": refuse("C641600002000000", 0x6041, 0, 0x06010002),
    "sdo: block download": """
        > 601#C27A600004000000
        < 581#A47A60007F000000
        > 601#8139300000000000
        < 581#A2017F0000000000
        > 601#CD00000000000000
        < 581#A100000000000000
        > 601#407A600000000000
        < 581#437A600039300000""",
    "sdo: block download, crc wrong": """
        > 601#C67A600004000000
        < 581#A47A60007F000000
        > 601#8139300000000000
        < 581#A2017F0000000000
        > 601#CDFFFF0000000000
        < 581#807A600004000405""",
    "sdo: block download, length wrong": """
        > 601#C27A600003000000
        < 581#807A600013000706""",
    "sdo: block download of 2000 bytes to an object of four": """
        > 601#C67A6000D0070000
        < 581#807A600012000706""",
    "sdo: block download, announced and real length differ": """
        > 601#C27A600004000000
        < 581#A47A60007F000000
        > 601#8139300000000000
        < 581#A2017F0000000000
        > 601#D100000000000000
        < 581#807A600010000706""",
    "sdo: block download, a segment is missing": """
        > 601#C27A600004000000
        < 581#A47A60007F000000
        > 601#8239300000000000
        < 581#A2007F0000000000""",
    "sdo: block download aborted": """
        > 601#C27A600004000000
        < 581#A47A60007F000000
        > 601#807A600000000008
        > 601#407A600000000000
        < 581#437A600000000000""",
    "pdo: rpdo takes effect at once": OPERATIONAL + "> 201#0600\n< 181#3102",
    "pdo: short rpdo is ignored": OPERATIONAL + "> 201#06\n< 081#1082110000000000\n+2",
    "pdo: long rpdo is processed": OPERATIONAL
    + "> 201#0600FFFF\n< 081#2082110000000000\n< 181#3102",
    "pdo: rpdo of another node": OPERATIONAL + "> 202#0600\n+2",
    "pdo: invalid rpdo": OPERATIONAL + "> 301#060001\n+2",
    "pdo: mapping while valid": refuse("2F00160000000000", 0x1600, 0, 0x06010000),
    "pdo: unmappable": """
        > 601#2301140101020080
        < 581#6001140100000000
        > 601#2F01160000000000
        < 581#6001160000000000
        > 601#2301160110004160
        < 581#8001160141000406""",
    "pdo: reserved transmission type": refuse("2F001402F1000000", 0x1400, 2, 0x06090030),
    "pdo: rtr type for an rpdo": refuse("2F001402FC000000", 0x1400, 2, 0x06090030),
    "pdo: identifier while valid": refuse("2300140102020000", 0x1400, 1, 0x08000022),
    "pdo: rtr is not allowed by default": OPERATIONAL + "> 181#R",
    "pdo: rtr allowed": """
        > 601#23001801810100C0
        < 581#6000180100000000
        > 601#2300180181010000
        < 581#6000180100000000
        > 000#0101
        < 181#5002
        > 181#R
        < 181#5002""",
    "pdo: event timer": """
        > 601#2B0018050A000000
        < 581#6000180500000000
        > 000#0101
        < 181#5002
        +9
        +1
        < 181#5002
        +10
        < 181#5002""",
    "pdo: inhibit time": """
        > 601#23001801810100C0
        < 581#6000180100000000
        > 601#2B001803C8000000
        < 581#6000180300000000
        > 601#2300180181010040
        < 581#6000180100000000
        > 000#0101
        < 181#5002
        > 201#0600
        +18
        +2
        < 181#3102""",
    "pdo: synchronous acyclic": """
        > 601#2F00180200000000
        < 581#6000180200000000
        > 000#0101
        > 080#
        < 181#5002
        > 080#
        > 201#0600
        +2
        > 080#
        < 181#3102""",
    "pdo: every sync": """
        > 601#2F00180201000000
        < 581#6000180200000000
        > 000#0101
        > 080#
        < 181#5002
        > 080#
        < 181#5002""",
    "pdo: every third sync": """
        > 601#2F00180203000000
        < 581#6000180200000000
        > 000#0101
        > 080#
        > 080#
        > 080#
        < 181#5002
        > 080#""",
    "pdo: synchronous rpdo waits for sync": """
        > 601#2F00140201000000
        < 581#6000140200000000
        > 000#0101
        < 181#5002
        > 201#0600
        +2
        > 080#
        < 181#3102""",
    "pdo: rtr sampled at sync": """
        > 601#23001801810100C0
        < 581#6000180100000000
        > 601#2F001802FC000000
        < 581#6000180200000000
        > 601#2300180181010000
        < 581#6000180100000000
        > 000#0101
        > 080#
        > 201#0600
        +2
        > 181#R
        < 181#5002
        > 080#
        > 181#R
        < 181#3102""",
    "sync: not in pre-operational": "> 601#2F00180201000000\n< 581#6000180200000000\n> 080#",
    "sync: counter not expected": OPERATIONAL + "> 080#05\n< 081#4082110000000000",
    "sync: message of two bytes is ignored": OPERATIONAL + "> 080#0501\n< 081#4082110000000000",
    "sync: identifier 1005h": """
        > 601#2305100081000000
        < 581#6005100000000000
        > 601#2F00180201000000
        < 581#6000180200000000
        > 000#0101
        > 080#
        > 081#
        < 181#5002""",
    "heartbeat: producer": """
        > 601#2B1710000A000000
        < 581#6017100000000000
        < 701#7F
        +10
        < 701#7F
        > 000#0101
        < 181#5002
        +10
        < 701#05
        > 000#0201
        +10
        < 701#04""",
    "heartbeat: off": "+50",
    "guarding: toggle bit alternates": "> 701#R\n< 701#7F\n> 701#R\n< 701#FF\n> 701#R\n< 701#7F",
    "guarding: answer contains the state": OPERATIONAL
    + "> 701#R\n< 701#05\n> 000#0201\n> 701#R\n< 701#84",
    "guarding: request to another node is ignored": "> 702#R",
    "guarding: life time": """
        > 601#2B0C100014000000
        < 581#600C100000000000
        > 601#2F0D100002000000
        < 581#600D100000000000
        > 000#0101
        < 181#5002
        > 701#R
        < 701#05
        +39
        +6
        < 081#3081110000000000
        > 701#R
        < 701#FF""",
    "extended frame": "> 00000601#4041600000000000",
    "unknown identifier": "> 7FF#0011223344556677",
    "sdo as remote frame": "> 601#R",
    "emcy: message with this node's identifier is ignored": "> 082#0010010000000000",
}


@pytest.mark.parametrize("script", CASES.values(), ids=CASES.keys())
def test_case(script):
    Bus().run(script)


def uploaded(bus, index, sub):
    """The bytes of an object, expedited or in segments."""
    bus.node.receive(Frame(0x601, struct.pack("<BHB4x", 0x40, index, sub)), 0)
    (answer,) = bus.node.poll(0)
    command = answer.data[0]
    if command & 2:
        return answer.data[4 : 8 - (command >> 2 & 3)]
    data, toggle = b"", 0
    while True:
        bus.node.receive(Frame(0x601, bytes([0x60 | toggle]) + bytes(7)), 0)
        (answer,) = bus.node.poll(0)
        command = answer.data[0]
        assert command & 0x10 == toggle
        data += answer.data[1 : 8 - (command >> 1 & 7)]
        toggle ^= 0x10
        if command & 1:
            return data


def test_upload_gives_the_bytes_of_every_readable_object():
    bus, told = Bus(), 0
    for address in sorted(bus.drive.objects.slots):
        expected, abort = bus.drive.objects.read(*address)
        if not abort:
            assert uploaded(bus, *address) == expected, f"{address[0]:04X}:{address[1]:02X}"
            told += 1
    assert told > 400


@pytest.mark.parametrize("size", [1, 2, 4, 127])
def test_block_upload_with_crc_and_a_lost_segment(size):
    bus = Bus()
    bus.node.receive(Frame(0x601, struct.pack("<BHBB3x", 0xA4, 0x1008, 0, size)), 0)
    (answer,) = bus.node.poll(0)
    assert answer.data == struct.pack("<BHBI", 0xC6, 0x1008, 0, len(NAME))
    bus.node.receive(Frame(0x601, b"\xa3" + bytes(7)), 0)
    data, lose = b"", True
    while True:
        block = bus.node.poll(0)
        if block[0].data[0] & 0xE0 == 0xC0 and len(block) == 1 and len(data) >= len(NAME):
            break
        good = 0
        for frame in block:
            if lose and frame.data[0] & 0x7F == 2:
                lose = False
                break
            good += 1
            data += frame.data[1:]
        bus.node.receive(Frame(0x601, bytes([0xA2, good, size]) + bytes(5)), 0)
    command, crc = struct.unpack_from("<BH", block[0].data)
    data = data[: len(data) - (command >> 2 & 7)]
    assert data.decode() == NAME
    assert crc == binascii.crc_hqx(data, 0)
    bus.node.receive(Frame(0x601, b"\xa1" + bytes(7)), 0)
    assert bus.node.poll(0) == []


def test_emergency_of_a_fault_and_of_its_end():
    bus = Bus()
    bus.drive.inject("external")
    assert [*map(str, bus.wait(3))] == ["081#0090010000000000"]
    bus.drive.clear_injected()
    bus.wait(2)
    bus.run("> 601#2B40600080000000\n< 581#6040600000000000\n< 081#0000000000000000")


def test_heartbeat_consumer_ends_operational_and_tells_the_drive():
    bus = Bus()
    bus.drive.write("consumer_heartbeat_time_1", 5 << 16 | 20)
    bus.run("> 000#0101\n< 181#5002\n> 705#05\n+19")
    bus.wait(5)
    assert bus.node.state == NmtState.PRE_OPERATIONAL
    assert bus.drive.axis.connection_lost
    assert bus.drive.read("error_code") == 0x8130
    bus.run("> 705#05")
    assert not bus.drive.axis.connection_lost


@pytest.mark.parametrize("seed", range(4))
def test_fuzzed_frames_do_no_harm(seed):
    fuzz(CASES, seed, 5_000)


@pytest.mark.slow
def test_a_million_fuzzed_frames_do_no_harm():
    for seed in range(100):
        fuzz(CASES, 1000 + seed, 10_000)
