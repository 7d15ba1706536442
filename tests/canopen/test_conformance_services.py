"""CiA 301 and 305 behaviour as lists of frames, second part: services beside SDO and PDO.

``>`` to the node, ``<`` from it, ``+n`` n ms pass. The node has node-id 1, or 255 in the LSS cases
that begin with "unconfigured", and has booted up. The identity is vendor-id 0, product code 402h,
revision 10000h, serial number 1.
"""

import datetime
import itertools
import random
import shutil
import struct

import pytest
from conformance import OPERATIONAL, Bus, fuzz, read, refuse, write

from servogym.drive.canopen.frame import Frame
from servogym.drive.canopen.node import NmtState, Node
from servogym.drive.canopen.time_stamp import TimeOfDay
from servogym.drive.drive import Drive
from servogym.drive.model.model import load

STATE, PARAMETER, INVALID, UNSUPPORTED = 0x08000022, 0x06040043, 0x06090030, 0x06010000
SELECT = """
> 7E5#4000000000000000
> 7E5#4102040000000000
> 7E5#4200000100000000
> 7E5#4301000000000000
< 7E4#4400000000000000
"""
CONFIGURE = "> 7E5#0401000000000000\n"
WAIT = "> 7E5#0400000000000000\n"
NO_FAULT = write(0x6007, 0, 0, 2)  # a lost connection is no fault of the drive

LSS = {
    "lss: no inquiry is answered in waiting": "> 7E5#5A00000000000000",
    "lss: switch global": CONFIGURE + "> 7E5#5B00000000000000\n< 7E4#5B02040000000000",
    "lss: switch back": CONFIGURE + WAIT + "> 7E5#5A00000000000000",
    "lss: switch to an unknown mode": "> 7E5#0402000000000000\n> 7E5#5A00000000000000",
    "lss: switch selective": SELECT + "> 7E5#5E00000000000000\n< 7E4#5E01000000000000",
    "lss: switch selective, wrong serial number": """
        > 7E5#4000000000000000
        > 7E5#4102040000000000
        > 7E5#4200000100000000
        > 7E5#4302000000000000
        > 7E5#5E00000000000000""",
    "lss: switch selective, a message is missing": """
        > 7E5#4000000000000000
        > 7E5#4200000100000000
        > 7E5#4301000000000000
        > 7E5#5E00000000000000""",
    "lss: inquire vendor-id": CONFIGURE + "> 7E5#5A00000000000000\n< 7E4#5A00000000000000",
    "lss: inquire revision": CONFIGURE + "> 7E5#5C00000000000000\n< 7E4#5C00000100000000",
    "lss: inquire serial number": CONFIGURE + "> 7E5#5D00000000000000\n< 7E4#5D01000000000000",
    "lss: inquire node-id": CONFIGURE + "> 7E5#5E00000000000000\n< 7E4#5E01000000000000",
    "lss: node-id becomes active at reset communication": CONFIGURE
    + """
        > 7E5#1105000000000000
        < 7E4#1100000000000000
        > 7E5#5E00000000000000
        < 7E4#5E01000000000000
        > 601#4000120100000000
        < 581#4300120101060000
        > 000#8201
        < 705#00
        > 601#4000120100000000
        > 605#4000120100000000
        < 585#4300120105060000
        > 605#4014100000000000
        < 585#4314100085000000
        > 605#4001180100000000
        < 585#43011801850200C0
        > 000#0105
        < 185#5002""",
    "lss: node-id 0": CONFIGURE + "> 7E5#1100000000000000\n< 7E4#1101000000000000",
    "lss: node-id 128": CONFIGURE + "> 7E5#1180000000000000\n< 7E4#1101000000000000",
    "lss: unstored node-id is lost at reset node": CONFIGURE
    + "> 7E5#1105000000000000\n< 7E4#1100000000000000\n> 000#8101\n< 701#00",
    "lss: stored node-id survives reset node": CONFIGURE
    + """
        > 7E5#1105000000000000
        < 7E4#1100000000000000
        > 7E5#1700000000000000
        < 7E4#1700000000000000
        > 000#8101
        < 705#00""",
    "lss: node-id removed": CONFIGURE
    + "> 7E5#11FF000000000000\n< 7E4#1100000000000000\n> 000#8201\n> 000#0100\n> 701#R",
    "lss: bit timing": CONFIGURE + "> 7E5#1300040000000000\n< 7E4#1300000000000000",
    "lss: bit timing, another table": CONFIGURE + "> 7E5#1301000000000000\n< 7E4#1301000000000000",
    "lss: bit timing reserved": CONFIGURE + "> 7E5#1300050000000000\n< 7E4#1301000000000000",
    "lss: bit timing unknown": CONFIGURE + "> 7E5#13000A0000000000\n< 7E4#1301000000000000",
    "lss: silence while the bit rate changes": CONFIGURE
    + """
        > 7E5#1300040000000000
        < 7E4#1300000000000000
        > 7E5#150A000000000000
        +1
        > 601#4041600000000000
        +20
        > 601#4041600000000000
        < 581#4B41600050020000""",
    "lss: activate bit timing without a configured one": CONFIGURE
    + "> 7E5#150A000000000000\n> 601#4041600000000000\n< 581#4B41600050020000",
    "lss: identify": """
        > 7E5#4600000000000000
        > 7E5#4702040000000000
        > 7E5#4800000000000000
        > 7E5#4900000200000000
        > 7E5#4A00000000000000
        > 7E5#4B05000000000000
        < 7E4#4F00000000000000""",
    "lss: identify, serial number below the range": """
        > 7E5#4600000000000000
        > 7E5#4702040000000000
        > 7E5#4800000000000000
        > 7E5#4900000200000000
        > 7E5#4A02000000000000
        > 7E5#4B05000000000000""",
    "lss: identify non-configured ignored by a configured node": "> 7E5#4C00000000000000",
    "lss: fastscan ignored by a configured node": "> 7E5#5100000000800000",
    "lss: seven bytes": "> 7E5#04010000000000\n> 7E5#5A00000000000000",
    "lss: works in stopped": "> 000#0201\n" + SELECT,
}
UNCONFIGURED = {
    "unconfigured: identify": "> 7E5#4C00000000000000\n< 7E4#5000000000000000",
    "unconfigured: no nmt": "> 000#0100\n> 000#8200",
    "unconfigured: no sdo": "> 601#4041600000000000\n> 6FF#4041600000000000",
    "unconfigured: no guarding, no heartbeat": "> 7FF#R\n> 7FE#R\n+20",
    "unconfigured: inquire node-id": CONFIGURE + "> 7E5#5E00000000000000\n< 7E4#5EFF000000000000",
    "unconfigured: boots up when switched back to waiting": CONFIGURE
    + "> 7E5#1109000000000000\n< 7E4#1100000000000000\n+3\n"
    + WAIT
    + "< 709#00\n> 609#4014100000000000\n< 589#4314100089000000",
    "unconfigured: remains so without a node-id": CONFIGURE + WAIT + "+3",
    "unconfigured: fastscan, no match": """
        > 7E5#5100000000800000
        < 7E4#4F00000000000000
        > 7E5#5100000080000000""",
    "unconfigured: fastscan, field out of order": """
        > 7E5#5100000000800000
        < 7E4#4F00000000000000
        > 7E5#5100000000000100""",
    "unconfigured: fastscan to the end": """
        > 7E5#5100000000800000
        < 7E4#4F00000000000000
        > 7E5#51000000001F0000
        < 7E4#4F00000000000000
        > 7E5#5100000000000001
        < 7E4#4F00000000000000
        > 7E5#51020400000A0101
        < 7E4#4F00000000000000
        > 7E5#5102040000000102
        < 7E4#4F00000000000000
        > 7E5#5100000100000203
        < 7E4#4F00000000000000
        > 7E5#5101000000000300
        < 7E4#4F00000000000000
        > 7E5#1107000000000000
        < 7E4#1100000000000000
        > 7E5#0400000000000000
        < 707#00""",
}
TIME = {
    "time: producer bit": refuse("2312100000010040", 0x1012, 0, INVALID),
    "time: identifier while in use": refuse("2312100001010080", 0x1012, 0, STATE),
    "time: identifier after switching off": write(0x1012, 0, 0x100, 4)
    + write(0x1012, 0, 0x8000_0200, 4),
    "time: restricted identifier": write(0x1012, 0, 0x100, 4)
    + refuse("2312100081050080", 0x1012, 0, INVALID),
    "time: restricted identifier, refused at once": refuse("2312100081050000", 0x1012, 0, INVALID),
    "time: no answer": "> 100#0000000001000000\n> 100#000000000100",
}
SYNC = {
    "sync: identifier of 29 bits": refuse("2305100080000020", 0x1005, 0, INVALID),
    "sync: identifier of more than 11 bits without bit 29": refuse(
        "2305100080080000", 0x1005, 0, INVALID
    ),
    "sync: restricted identifier": refuse("2305100001060000", 0x1005, 0, INVALID),
    "sync: identifier while producing": write(0x1005, 0, 0x4000_0080, 4)
    + refuse("2305100081000040", 0x1005, 0, STATE),
    "sync: producer": write(0x1006, 0, 5000, 4)
    + write(0x1005, 0, 0x4000_0080, 4)
    + "< 080#\n+4\n+1\n< 080#\n+5\n< 080#\n"
    + write(0x1005, 0, 0x80, 4)
    + "+20",
    "sync: no producer without a period": write(0x1005, 0, 0x4000_0080, 4) + "+20",
    "sync: producer with counter": write(0x1019, 0, 3, 1)
    + write(0x1006, 0, 2000, 4)
    + write(0x1005, 0, 0x4000_0080, 4)
    + "< 080#01\n+2\n< 080#02\n+2\n< 080#03\n+2\n< 080#01",
    "sync: producer pauses in stopped and restarts with 1": write(0x1019, 0, 3, 1)
    + write(0x1006, 0, 2000, 4)
    + write(0x1005, 0, 0x4000_0080, 4)
    + "< 080#01\n+2\n< 080#02\n> 000#0201\n+9\n> 000#8001\n< 080#01",
    "sync: producer's own synchronous pdos": write(0x1800, 2, 1, 1)
    + write(0x1006, 0, 5000, 4)
    + write(0x1005, 0, 0x4000_0080, 4)
    + "< 080#\n> 000#0101\n+5\n< 080#\n< 181#5002",
    "sync: counter 1": refuse("2F19100001000000", 0x1019, 0, INVALID),
    "sync: counter 241": refuse("2F191000F1000000", 0x1019, 0, INVALID),
    "sync: counter 255": refuse("2F191000FF000000", 0x1019, 0, INVALID),
    "sync: counter 240": write(0x1019, 0, 240, 1),
    "sync: counter changes only without a period": write(0x1006, 0, 1000, 4)
    + refuse("2F19100005000000", 0x1019, 0, STATE),
    "sync: counter is missing": write(0x1019, 0, 10, 1)
    + OPERATIONAL
    + "> 080#\n< 081#4082110000000000\n> 080#\n> 080#01\n< 081#0000000000000000",
    "sync: message of wrong length is ignored": write(0x1800, 2, 1, 1)
    + "> 000#0101\n> 080#05\n< 081#4082110000000000\n> 080#\n< 081#0000000000000000\n< 181#5002",
    "sync: start value": write(0x1019, 0, 4, 1)
    + write(0x1800, 1, 0xC000_0181, 4)
    + write(0x1800, 6, 3, 1)
    + write(0x1800, 2, 2, 1)
    + write(0x1800, 1, 0x4000_0181, 4)
    + "> 000#0101\n> 080#01\n> 080#02\n> 080#03\n< 181#5002\n> 080#04\n> 080#01\n< 181#5002",
    "sync: start value while valid": refuse("2F00180603000000", 0x1800, 6, STATE),
    "sync: rpdo after the window is ignored": write(0x1007, 0, 3000, 4)
    + write(0x1400, 2, 1, 1)
    + OPERATIONAL
    + "> 080#\n+4\n> 201#0600\n> 080#\n+2",
    "sync: rpdo in the window is processed": write(0x1007, 0, 3000, 4)
    + write(0x1400, 2, 1, 1)
    + OPERATIONAL
    + "> 080#\n+3\n> 201#0600\n> 080#\n< 181#3102",
    "sync: not processed in stopped": write(0x1800, 2, 1, 1) + "> 000#0101\n> 000#0201\n> 080#",
}
RPDO = {
    "rpdo: short, reported once, then good": OPERATIONAL
    + "> 201#06\n< 081#1082110000000000\n> 201#06\n> 201#0000\n< 081#0000000000000000",
    "rpdo: long, then good": OPERATIONAL
    + "> 201#000000\n< 081#2082110000000000\n> 201#0000\n< 081#0000000000000000",
    "rpdo: empty": OPERATIONAL + "> 201#\n< 081#1082110000000000",
    "rpdo: deadline starts with the first rpdo": write(0x1400, 5, 10, 2) + OPERATIONAL + "+50",
    "rpdo: deadline": write(0x1400, 5, 10, 2)
    + write(0x2020, 13, 0, 1)
    + OPERATIONAL
    + "> 201#0000\n+10\n> 201#0000\n+11\n< 081#5082110000000000\n+30\n> 201#0000\n"
    + "< 081#0000000000000000",
    "rpdo: deadline is a fault of the drive": write(0x1400, 5, 10, 2)
    + OPERATIONAL
    + "> 201#0000\n+13\n< 081#5082110000000000\n< 181#1802\n"
    + read(0x1003, 0, "4F03100001000000"),
    "rpdo: deadline stops with operational": write(0x1400, 5, 10, 2)
    + OPERATIONAL
    + "> 201#0000\n> 000#8001\n+30",
    "rpdo: two with one identifier": """
        > 601#2301140101020080
        < 581#6001140100000000
        > 601#2301160120007A60
        < 581#6001160100000000
        > 601#2F01160001000000
        < 581#6001160000000000
        > 601#2F00140200000000
        < 581#6000140200000000
        > 601#2301140101020000
        < 581#6001140100000000
        > 000#0101
        < 181#5002
        > 201#39300000
        < 081#2082110000000000
        > 601#407A600000000000
        < 581#437A600039300000""",
    "rpdo: sync identifier": write(0x1401, 1, 0x8000_0301, 4)
    + refuse("2301140180000000", 0x1401, 1, INVALID),
    "rpdo: identifier of 29 bits": refuse("2301140101030020", 0x1401, 1, INVALID),
}
CONTROLWORD, TARGET = 0x60400010, 0x607A0020  # as entries of a mapping
MAPPING = {
    "mapping: two objects": write(0x1601, 1, CONTROLWORD, 4)
    + write(0x1601, 2, TARGET, 4)
    + write(0x1601, 0, 2, 1)
    + write(0x1401, 1, 0x301, 4)
    + OPERATIONAL
    + "> 301#060039300000\n< 181#3102\n"
    + read(0x607A, 0, "437A600039300000"),
    "mapping: dummy": write(0x1601, 1, 0x00060010, 4)
    + write(0x1601, 2, TARGET, 4)
    + write(0x1601, 0, 2, 1)
    + write(0x1401, 1, 0x301, 4)
    + OPERATIONAL
    + "> 301#FFFF39300000\n"
    + read(0x607A, 0, "437A600039300000"),
    "mapping: dummy in a tpdo": refuse("23011A0110000600", 0x1A01, 1, 0x06040041),
    "mapping: dummy of another length": refuse("2301160120000600", 0x1601, 1, 0x06040041),
    "mapping: more than 64 bits": write(0x1601, 1, TARGET, 4)
    + write(0x1601, 2, TARGET, 4)
    + write(0x1601, 3, CONTROLWORD, 4)
    + refuse("2F01160003000000", 0x1601, 0, 0x06040042),
    "mapping: more entries than there are": refuse("2F01160011000000", 0x1601, 0, 0x06040042),
    "mapping: a reserved number of entries": refuse("2F01160041000000", 0x1601, 0, INVALID),
    "tpdo: without entries nothing is sent": write(0x1801, 1, 0x281, 4)
    + "> 000#0101\n< 181#5002\n+9\n> 281#R\n> 080#",
    "mapping: length is not that of the object": refuse("2301160120004060", 0x1601, 1, 0x06040041),
    "mapping: no such object": refuse("2301160110000070", 0x1601, 1, 0x06020000),
    "mapping: no such sub-index": refuse("2301160120097D60", 0x1601, 1, 0x06090011),
    "mapping: entries change only while their number is 0": write(0x1601, 1, CONTROLWORD, 4)
    + write(0x1601, 0, 1, 1)
    + refuse("2301160120007A60", 0x1601, 1, UNSUPPORTED),
    "mapping: tpdo": write(0x1A01, 1, 0x60640020, 4)
    + write(0x1A01, 0, 1, 1)
    + write(0x1801, 1, 0x4000_0281, 4)
    + "> 000#0101\n< 181#5002\n< 281#00000000",
    "tpdo: on request only": write(0x1800, 1, 0xC000_0181, 4)
    + write(0x1800, 2, 253, 1)
    + write(0x1800, 1, 0x181, 4)
    + "> 000#0101\n+20\n> 181#R\n< 181#5002",
    "tpdo: type 240": write(0x1800, 2, 240, 1),
    "tpdo: type 251 is reserved": refuse("2F001802FB000000", 0x1800, 2, INVALID),
    "tpdo: sent when it becomes valid in operational": write(0x1800, 1, 0xC000_0181, 4)
    + "> 000#0101\n> 601#2300180181010040\n< 581#6000180100000000\n< 181#5002",
    "pdo: sub-index 4 is reserved": refuse("4000140400000000", 0x1400, 4, 0x06090011),
    "pdo: there are four in each direction": refuse("4004140000000000", 0x1404, 0, 0x06020000),
}
ERROR_CONTROL = {
    "heartbeat consumer: second entry for a node-id is refused": write(0x1016, 1, 5 << 16 | 20, 4)
    + refuse("2316100214000500", 0x1016, 2, PARAMETER),
    "heartbeat consumer: second entry for a node-id with time 0": write(0x1016, 1, 5 << 16 | 20, 4)
    + write(0x1016, 2, 5 << 16, 4),
    "heartbeat consumer: the same entry again": write(0x1016, 1, 5 << 16 | 20, 4)
    + write(0x1016, 1, 5 << 16 | 30, 4),
    "heartbeat consumer: reserved bits": refuse("2316100114000501", 0x1016, 1, INVALID),
    "heartbeat consumer: there is no ninth entry": refuse(
        "2316100914000500", 0x1016, 9, 0x06090011
    ),
    "heartbeat consumer: monitoring starts with the first one": write(0x1016, 1, 5 << 16 | 20, 4)
    + "+90",
    "heartbeat consumer: heartbeat of another node is ignored": write(0x1016, 1, 5 << 16 | 20, 4)
    + "> 706#05\n+90",
    "heartbeat consumer: lost and resumed": NO_FAULT
    + write(0x1016, 3, 5 << 16 | 20, 4)
    + "> 705#05\n+20\n> 705#05\n+21\n< 081#3081110000000000\n+60\n"
    + "> 705#05\n< 081#0000000000000000",
    "heartbeat consumer: two lost, one resumed": NO_FAULT
    + write(0x1016, 1, 5 << 16 | 20, 4)
    + write(0x1016, 2, 6 << 16 | 30, 4)
    + "> 705#05\n> 706#05\n+40\n< 081#3081110000000000\n< 081#3081110000000000\n"
    + "> 705#05\n> 706#05\n< 081#0000000000000000",
    "heartbeat consumer: loss is a fault of the drive": write(0x1016, 1, 5 << 16 | 20, 4)
    + "> 705#05\n+25\n< 081#3081110000000000\n"
    + read(0x603F, 0, "4B3F600030810000")
    + "\n"
    + read(0x1003, 0, "4F03100001000000"),
    "heartbeat consumer: two lost, one of them a fault of the drive": write(
        0x1016, 1, 5 << 16 | 20, 4
    )
    + write(0x1016, 2, 6 << 16 | 20, 4)
    + "> 705#05\n> 706#05\n+25\n< 081#3081110000000000\n< 081#3081110000000000",
    "heartbeat consumer: entry removed": NO_FAULT
    + write(0x1016, 1, 5 << 16 | 20, 4)
    + "> 705#05\n+25\n< 081#3081110000000000\n"
    + write(0x1016, 1, 0, 4)
    + "< 081#0000000000000000",
    "1029h: 0 leaves operational": NO_FAULT
    + write(0x1016, 1, 5 << 16 | 20, 4)
    + OPERATIONAL
    + "> 705#05\n+25\n< 081#3081110000000000\n> 701#R\n< 701#7F",
    "1029h: 1 changes nothing": NO_FAULT
    + write(0x1029, 1, 1, 1)
    + write(0x1016, 1, 5 << 16 | 20, 4)
    + OPERATIONAL
    + "> 705#05\n+25\n< 081#3081110000000000\n> 701#R\n< 701#05",
    "1029h: 2 enters stopped": NO_FAULT
    + write(0x1029, 1, 2, 1)
    + write(0x1016, 1, 5 << 16 | 20, 4)
    + OPERATIONAL
    + "> 705#05\n+25\n< 081#3081110000000000\n> 701#R\n< 701#04",
    "1029h: 3 is refused as too high": refuse("2F29100103000000", 0x1029, 1, 0x06090031),
    "heartbeat: guarding is not answered while it is produced": write(0x1017, 0, 100, 2)
    + "< 701#7F\n> 701#R",
    "heartbeat: the boot-up message is the first": write(0x1017, 0, 10, 2)
    + "< 701#7F\n> 601#2310100173617665\n< 581#6010100100000000\n"
    + "> 000#8201\n< 701#00\n+9\n+1\n< 701#7F",
    "heartbeat: a new period starts at once": write(0x1017, 0, 50, 2)
    + "< 701#7F\n+10\n"
    + write(0x1017, 0, 20, 2)
    + "< 701#7F\n+20\n< 701#7F",
    "guarding: toggle bit starts with 0 after a reset": "> 701#R\n< 701#7F\n> 000#8201\n< 701#00\n"
    + "> 701#R\n< 701#7F",
    "guarding: life time starts with the first request": write(0x100C, 0, 20, 2)
    + write(0x100D, 0, 2, 1)
    + "+90",
    "guarding: lost and resumed": NO_FAULT
    + write(0x100C, 0, 20, 2)
    + write(0x100D, 0, 2, 1)
    + "> 701#R\n< 701#7F\n+41\n< 081#3081110000000000\n+90\n"
    + "> 701#R\n< 701#FF\n< 081#0000000000000000",
}
EMCY = {
    "emcy: identifier may not change while valid": refuse("2314100082000000", 0x1014, 0, STATE),
    "emcy: identifier may change while invalid": write(0x1014, 0, 0x8000_0081, 4)
    + write(0x1014, 0, 0x82, 4)
    + OPERATIONAL
    + "> 201#06\n< 082#1082110000000000",
    "emcy: no message while invalid": write(0x1014, 0, 0x8000_0081, 4) + OPERATIONAL + "> 201#06",
    "emcy: reserved bit": refuse("2314100081000040", 0x1014, 0, INVALID),
    "emcy: identifier of 29 bits": refuse("2314100081000020", 0x1014, 0, INVALID),
    "emcy: restricted identifier": write(0x1014, 0, 0x8000_0081, 4)
    + refuse("2314100001060000", 0x1014, 0, INVALID),
    "emcy: inhibit time": write(0x1015, 0, 100, 2)
    + OPERATIONAL
    + "> 201#06\n< 081#1082110000000000\n> 080#01\n+9\n+1\n< 081#4082110000000000",
    "emcy: history, newest first": OPERATIONAL
    + "> 201#06\n< 081#1082110000000000\n> 080#01\n< 081#4082110000000000\n"
    + read(0x1003, 0, "4F03100002000000")
    + "\n"
    + read(0x1003, 1, "4303100140820000")
    + "\n"
    + read(0x1003, 2, "4303100210820000"),
    "emcy: no data in an empty history": read(0x1003, 0, "4F03100000000000")
    + "\n"
    + refuse("4003100100000000", 0x1003, 1, 0x08000024),
    "emcy: no data beyond the last error": OPERATIONAL
    + "> 201#06\n< 081#1082110000000000\n"
    + read(0x1003, 1, "4303100110820000")
    + "\n"
    + refuse("4003100200000000", 0x1003, 2, 0x08000024),
    "emcy: only 0 clears the history": OPERATIONAL
    + "> 201#06\n< 081#1082110000000000\n"
    + refuse("2F03100001000000", 0x1003, 0, INVALID)
    + "\n"
    + write(0x1003, 0, 0, 1)
    + read(0x1003, 0, "4F03100000000000"),
    "emcy: error register has bit 4 and bit 0": OPERATIONAL
    + "> 201#06\n< 081#1082110000000000\n"
    + read(0x1001, 0, "4F01100011000000")
    + "\n> 201#0000\n< 081#0000000000000000\n"
    + read(0x1001, 0, "4F01100000000000"),
    "emcy: reset communication ends the communication errors": OPERATIONAL
    + "> 201#06\n< 081#1082110000000000\n> 000#8201\n< 701#00\n"
    + read(0x1001, 0, "4F01100000000000"),
    "emcy: no message while one of two errors remains": OPERATIONAL
    + "> 201#06\n< 081#1082110000000000\n> 080#01\n< 081#4082110000000000\n> 080#\n"
    + "> 201#0000\n< 081#0000000000000000",
}
SDO = {
    "sdo server 2: off by default": "> 641#4041600000000000",
    "sdo server 2": write(0x1201, 1, 0x480, 4)
    + write(0x1201, 2, 0x481, 4)
    + "> 480#4041600000000000\n< 481#4B41600050020000\n"
    + read(0x6041, 0, "4B41600050020000"),
    "sdo server 2: one identifier is not enough": write(0x1201, 1, 0x480, 4)
    + "> 480#4041600000000000",
    "sdo server 2: identifier while valid": write(0x1201, 1, 0x480, 4)
    + refuse("2301120182040000", 0x1201, 1, STATE),
    "sdo server 2: restricted identifier": refuse("2301120101060000", 0x1201, 1, INVALID),
    "sdo server 2: dynamic": refuse("2301120180040040", 0x1201, 1, INVALID),
    "sdo server 2: node-id of the client": write(0x1201, 3, 5, 1)
    + refuse("2F01120380000000", 0x1201, 3, INVALID),
    "sdo: segmented upload to the end, then another segment": """
        > 601#4009100000000000
        < 581#4109100008000000
        > 601#6000000000000000
        < 581#00656D756C617465
        > 601#7000000000000000
        < 581#1D64000000000000
        > 601#6000000000000000
        < 581#8000000001000405""",
    "sdo: block download, much too long": refuse("C27A600000000100", 0x607A, 0, 0x06070012),
    "sdo: block upload, confirmed with block size 0": """
        > 601#A409100001000000
        < 581#C609100008000000
        > 601#A300000000000000
        < 581#01656D756C617465
        > 601#A201000000000000
        < 581#8009100002000405""",
    "sdo: block upload, more segments confirmed than sent": """
        > 601#A409100001000000
        < 581#C609100008000000
        > 601#A300000000000000
        < 581#01656D756C617465
        > 601#A202010000000000
        < 581#8009100003000405""",
    "sdo: block upload, segments confirmed before the start": """
        > 601#A409100001000000
        < 581#C609100008000000
        > 601#A300000000000000
        < 581#01656D756C617465
        > 601#A409100001000000
        < 581#C609100008000000
        > 601#A201010000000000
        < 581#8009100001000405""",
    "sdo: block upload, started twice": """
        > 601#A409100001000000
        < 581#C609100008000000
        > 601#A300000000000000
        < 581#01656D756C617465
        > 601#A300000000000000
        < 581#8009100001000405""",
    "sdo: block upload, ended before the last segment": """
        > 601#A409100001000000
        < 581#C609100008000000
        > 601#A300000000000000
        < 581#01656D756C617465
        > 601#A100000000000000
        < 581#8009100001000405""",
    "sdo: block upload, segments confirmed after the end": """
        > 601#A409100002000000
        < 581#C609100008000000
        > 601#A300000000000000
        < 581#01656D756C617465
        < 581#8264000000000000
        > 601#A202020000000000
        < 581#D92FFB0000000000
        > 601#A202020000000000
        < 581#8009100001000405""",
    "sdo: a dead client's block download does not block others": """
        > 601#C07A600000000000
        < 581#A47A60007F000000
        > 601#0139300000000000
        +400
        > 601#4041600000000000
        +400
        > 601#4041600000000000
        +202
        < 581#807A600000000405
        > 601#4041600000000000
        < 581#4B41600050020000""",
    "sdo: segments of a block download keep it alive": """
        > 601#C27A600004000000
        < 581#A47A60007F000000
        +900
        > 601#8139300000000000
        < 581#A2017F0000000000
        +900
        > 601#CD00000000000000
        < 581#A100000000000000""",
    "sdo: block upload confirmed without a transfer": refuse(
        "A201100000000000", 0x1001, 0, 0x05040001
    ),
    "sdo server 1: read only": refuse("2300120180040000", 0x1200, 1, 0x06010002),
    "sdo server 2: a transfer of its own": write(0x1201, 1, 0x480, 4)
    + write(0x1201, 2, 0x481, 4)
    + """
        > 601#4008100000000000
        < 581#410810001E000000
        > 480#4008100000000000
        < 481#410810001E000000
        > 601#6000000000000000
        < 581#00736572766F6779
        > 480#6000000000000000
        < 481#00736572766F6779""",
}
STATES = {
    "nmt: start twice": OPERATIONAL + "> 000#0101",
    "nmt: stop, then start": "> 000#0201\n" + OPERATIONAL,
    "nmt: stop from operational": OPERATIONAL + "> 000#0201\n> 701#R\n< 701#04",
    "nmt: pre-operational from operational": OPERATIONAL + "> 000#8001\n> 701#R\n< 701#7F",
    "nmt: reset communication in stopped": "> 000#0201\n> 000#8201\n< 701#00\n> 701#R\n< 701#7F",
    "nmt: reset node in stopped": "> 000#0201\n> 000#8101\n< 701#00\n> 701#R\n< 701#7F",
    "nmt: reset communication of all": OPERATIONAL + "> 000#8200\n< 701#00",
    "nmt: stopped has no time": "> 000#0201\n> 100#000000000100",
    "nmt: stopped keeps heartbeat consumption": NO_FAULT
    + write(0x1016, 1, 5 << 16 | 20, 4)
    + "> 705#05\n> 000#0201\n+30\n> 000#8001\n< 081#3081110000000000",
    "nmt: as remote frame": "> 000#R\n> 701#R\n< 701#7F",
    "nmt: reset communication keeps the profile": write(0x607A, 0, 5, 4)
    + write(0x1017, 0, 0, 2)
    + write(0x1006, 0, 7, 4)
    + "> 000#8201\n< 701#00\n"
    + read(0x607A, 0, "437A600005000000")
    + "\n"
    + read(0x1006, 0, "4306100000000000"),
    "nmt: reset node restores defaults": write(0x607A, 0, 5, 4)
    + "> 000#8101\n< 701#00\n"
    + read(0x607A, 0, "437A600000000000"),
}
CASES = LSS | TIME | SYNC | RPDO | MAPPING | ERROR_CONTROL | EMCY | SDO | STATES


@pytest.mark.parametrize("script", CASES.values(), ids=CASES.keys())
def test_case(script):
    Bus().run(script)


@pytest.mark.parametrize("script", UNCONFIGURED.values(), ids=UNCONFIGURED.keys())
def test_unconfigured(script):
    Bus(255).run(script)


def test_a_node_id_has_to_be_one():
    with pytest.raises(ValueError, match=r"node_id = 200 is out of range 1..127"):
        Node(Drive(), 200)


def test_a_node_id_of_its_own_moves_the_drive():
    drive = Drive(node_id=1)
    assert [*map(str, Node(drive, 5).poll(0))] == ["705#00"]
    assert drive.read(0x1400, 1) == 0x205


def test_a_producer_that_is_polled_seldom_does_not_catch_up():
    bus = Bus()
    bus.run(write(0x1006, 0, 5000, 4) + write(0x1005, 0, 0x4000_0080, 4) + "< 080#")
    counts = [len(bus.node.poll(time)) for time in (52_000, 56_000, 57_000)]
    assert counts == [1, 0, 1]


@pytest.mark.parametrize(
    ("index", "subindex", "identifier"),
    [(0x1017, 0, 0x701), (0x1800, 5, 0x181)],
    ids=["heartbeat", "event timer"],
)
@pytest.mark.parametrize("period", [1, 10])
def test_a_period_keeps_its_mean_whatever_the_jitter_of_the_poller(
    index, subindex, identifier, period
):
    bus = Bus()
    bus.drive.write(index, subindex, period)
    bus.node.receive(Frame(0, b"\1\1"), 0)
    random_, time, times = random.Random(3), 0, []
    while time < 2_000_000:
        time += random_.randint(100, 900)
        times += [time for frame in bus.node.poll(time) if frame.id == identifier]
    mean = (times[-1] - times[1]) / (len(times) - 2)
    assert mean == pytest.approx(period * 1000, abs=1)
    assert max(b - a for a, b in itertools.pairwise(times[1:])) <= period * 1000 + 900


@pytest.mark.parametrize(
    ("index", "subindex", "identifier"), [(0x1017, 0, 0x701), (0x1800, 5, 0x181)]
)
def test_what_is_polled_seldom_does_not_catch_up(index, subindex, identifier):
    bus = Bus()
    bus.drive.write(index, subindex, 5)
    bus.node.receive(Frame(0, b"\1\1"), 0)
    bus.node.poll(0)
    counts = [
        sum(frame.id == identifier for frame in bus.node.poll(time))
        for time in (52_000, 53_000, 56_000, 57_000)
    ]
    assert counts == [1, 0, 0, 1]


def test_a_fault_reset_leaves_the_bit_of_a_communication_error():
    bus = Bus()
    bus.run(write(0x1800, 1, 0xC000_0181, 4) + "> 000#0101\n> 201#06\n< 081#1082110000000000")
    bus.drive.inject("overvoltage")
    assert [*map(str, bus.wait(2))] == ["081#1032150000000000"]
    bus.drive.clear_injected()
    bus.wait(2)
    bus.run(write(0x6040, 0, 0x80, 2) + "< 081#0000110000000000")
    assert bus.drive.read("error_register") == 0x11
    bus.run("> 201#0000\n< 081#0000000000000000")


def test_the_owner_learns_the_bit_rate_after_the_first_delay():
    bus = Bus()
    bus.run(CONFIGURE + "> 7E5#1300040000000000\n< 7E4#1300000000000000\n> 7E5#1505000000000000")
    bus.wait(4)
    assert bus.node.bit_rate is None
    bus.wait(1)
    assert bus.node.bit_rate == 125_000


def test_a_stored_identifier_that_follows_the_node_id_moves_with_it():
    bus = Bus()
    bus.run("> 601#2310100173617665\n< 581#6010100100000000")
    bus.drive.node_id = 9
    bus.drive.reset_communication()
    assert bus.drive.read("cob_id_emcy") == 0x89
    assert bus.drive.read(0x1400, 1) == 0x209


def test_a_stored_identifier_of_its_own_stays():
    bus = Bus()
    bus.run(write(0x1014, 0, 0x8000_0081, 4) + write(0x1014, 0, 0xA5, 4))
    bus.run("> 601#2310100173617665\n< 581#6010100100000000")
    bus.drive.node_id = 9
    bus.drive.reset_communication()
    assert bus.drive.read("cob_id_emcy") == 0xA5


def test_time_is_kept_and_goes_on():
    bus = Bus()
    data = struct.pack("<IH", 86_399_500 | 0xF000_0000, 14_610)
    assert bus.node.time_stamp.now(0) is None
    bus.run(f"> 100#{data.hex()}")
    now = bus.node.time_stamp.now(bus.time + 1_500_000)
    assert now == TimeOfDay(14_611, 1000)
    assert now.datetime() == datetime.datetime(2024, 1, 2, 0, 0, 1)
    bus.run("> 100#FFFFFF0F0100")
    assert bus.node.time_stamp.last.days == 14_610, "a time after the end of the day is none"


def test_synchronous_tpdos_that_are_late_are_dropped():
    bus = Bus()
    bus.run(write(0x1007, 0, 3000, 4) + write(0x1800, 2, 1, 1) + "> 000#0101")
    for late, frames in ((3000, ["181#5002"]), (3001, [])):
        bus.node.receive(Frame(0x80), bus.time)
        bus.time += late
        assert [*map(str, bus.node.poll(bus.time))] == frames


def test_the_deadline_of_an_rpdo_disappears_with_the_rpdo():
    bus = Bus()
    bus.run(write(0x1400, 5, 10, 2) + write(0x2020, 13, 0, 1) + OPERATIONAL + "> 201#0000")
    bus.wait(20)
    assert bus.drive.axis.rpdo_timeout
    bus.node.receive(Frame(0x601, bytes.fromhex("2300140101020080")), bus.time)
    bus.node.poll(bus.time)
    assert not bus.drive.axis.rpdo_timeout


def test_remote_frames_without_a_poll_do_not_pile_up():
    bus = Bus()
    bus.run(write(0x1800, 1, 0xC000_0181, 4) + write(0x1800, 1, 0x181, 4) + OPERATIONAL)
    for _ in range(3000):
        bus.node.receive(Frame(0x181, remote=True), bus.time)
        bus.node.receive(Frame(0x701, remote=True), bus.time)
    assert len(bus.node.poll(bus.time)) <= 1024


def test_a_lost_heartbeat_tells_the_drive_until_it_is_back():
    bus = Bus()
    bus.run(NO_FAULT + write(0x1016, 2, 5 << 16 | 20, 4) + OPERATIONAL + "> 705#05")
    bus.wait(25)
    assert bus.drive.axis.connection_lost
    assert bus.node.state == NmtState.PRE_OPERATIONAL
    bus.run("> 705#05\n< 081#0000000000000000")
    assert not bus.drive.axis.connection_lost


@pytest.mark.parametrize("node_id", [1, 255])
def test_fuzzed_frames_of_all_services_do_no_harm(node_id):
    fuzz(CASES | UNCONFIGURED, 7, 3_000, node_id)


@pytest.fixture
def large_model(tmp_path):
    """Generic with 512 PDOs each way, and without 1005h and 1014h."""
    folder = tmp_path / "large"
    shutil.copytree(load("generic").folder, folder)
    pdos = "direction,number,cob_id,transmission_type,inhibit_time,position,index,subindex,bits"
    rows = [f"{d},{n},0x80000000,255,0,,,,,," for d in ("rx", "tx") for n in range(1, 513)]
    (folder / "pdo.csv").write_text("\n".join([pdos + ",note,section", *rows]) + "\n")
    lines = (folder / "objects.csv").read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if line[:6] not in ("0x1005", "0x1014")]
    (folder / "objects.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    return folder


def test_all_of_512_pdos_are_found(large_model):
    drive = Drive(large_model, node_id=1)
    for n in range(512):
        for communication, mapping, base, entry in (
            (0x1400, 0x1600, 0x182, 0x60710010),
            (0x1800, 0x1A00, 0x381, 0x60640020),
        ):
            drive.write(mapping + n, 1, entry)
            drive.write(mapping + n, 0, 1)
            drive.write(communication + n, 2, 1)
            identifier = base + n % 120 if communication == 0x1400 else base + n % 500
            drive.write(communication + n, 1, identifier)
    node = Node(drive)
    node.receive(Frame(0, b"\1\0"), 0)
    node.poll(0)
    node.receive(Frame(0x182 + 511 % 120, struct.pack("<h", 77)), 0)
    node.receive(Frame(0x80), 0)
    assert drive.read("target_torque") == 77
    assert len(node.poll(0)) == 512


def test_a_model_without_identifier_objects_has_the_default_ones(large_model):
    drive = Drive(large_model, node_id=3)
    node = Node(drive)
    drive.inject("external")
    drive.cycle(0.0)
    assert [f.id for f in node.poll(0)] == [0x703, 0x083]
    assert node.sync.identifier == 0x80
