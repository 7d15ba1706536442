"""Damaged and made-up files of others, and what our readers say to them.

    python tests/model/damaged_files.py esi --count 200000 --seed 1 --out esi.csv

Every input ends with what it holds, or with one line that names the file and the place in it
(line, byte or word). Anything else (an exception of another kind, more than `LONGEST` seconds of
processor time, more than `MEMORY` bytes) is a finding: it is kept beside the table, and counted.
Half of the inputs are our own files with some bytes, numbers, lines or words changed, half are put
together from the words of the format.
"""

import argparse
import csv
import functools
import gc
import random
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import can

from servogym.drive.canopen import eds
from servogym.drive.canopen.sheet import read_sheet
from servogym.drive.ethercat import esi, sii
from servogym.drive.ethercat.decode import EtherCatDecoder
from servogym.drive.imports.eds import import_eds, model_of
from servogym.drive.imports.ethercat import import_esi, import_sii, unpacked
from servogym.drive.model.model import DriveModel, load
from servogym.drive.wire import log, pcapng
from servogym.drive.wire.recording import Source

LONGEST = 1  # s of processor time
MEMORY = 2**30  # bytes beyond what the process had before
MODELS = ("generic", "kollmorgen_akd", "festo_cmmp_as")
GOLDEN = Path(__file__).parents[1] / "golden"
PLACE = re.compile(r"line \d+|byte \d+|word [0-9A-F]+h|of a drive passes in it")  # or the whole
NUMBERS = (
    "0", "1", "-1", "255", "256", "65535", "65536", "4294967296", "-2147483649", "9" * 40, "0x",
    "0xFFFFFFFFFFFFFFFFFF", "#x", "#xFFFFFFFFF", "1e400", "nan", "", "$NODEID", "µ", "\t",
    "$NODEID+0x80000000", "0x6040", "#x6040", "#x1600", "0.5", "true", "-", "½", "二",
)
Texts = list[str]
Bytes = list[bytes]


def bytes_changed(data: bytes, chance: random.Random) -> bytes:
    """Some bytes are others, gone, doubled, or cut off."""
    found = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 4, 16))):
        at, length = chance.randrange(len(found) or 1), chance.choice((1, 1, 2, 4, 40, 400))
        kind = chance.randrange(5)
        if kind == 0:
            found[at : at + length] = chance.randbytes(length)
        elif kind == 1:
            del found[at : at + length]
        elif kind == 2:
            found[at:at] = found[at : at + length]
        elif kind == 3:
            found[at : at + length] = bytes([chance.choice((0, 0xFF, 0x7F, 0x80))]) * length
        elif chance.random() < 0.2:
            del found[at:]
    return bytes(found)


def lines_changed(data: bytes, chance: random.Random, words: tuple[str, ...]) -> bytes:
    """Some numbers, words and lines are others or gone."""
    lines = data.decode("utf-8", "replace").split("\n")
    for _ in range(chance.randint(1, 10)):
        if not lines:
            break
        at = chance.randrange(len(lines))
        kind = chance.randrange(6)
        if kind == 0:
            del lines[at : at + chance.choice((1, 1, 3, 20))]
        elif kind == 1:
            lines.insert(at, chance.choice(words))
        elif kind == 2:
            numbers = [*re.finditer(r"[#$]?[0-9A-Za-z]+", lines[at])]
            if numbers:
                one = chance.choice(numbers)
                other = chance.choice(NUMBERS if chance.random() < 0.7 else words)
                lines[at] = lines[at][: one.start()] + other + lines[at][one.end() :]
        elif kind == 3:
            lines[at : at + 1] = [lines[at]] * chance.choice((2, 2, 50))
        elif kind == 4:
            lines[at] = lines[at][: chance.randrange(len(lines[at]) + 1)]
        else:
            other = chance.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
    return "\n".join(lines).encode("utf-8", "replace")


def written_otherwise(data: bytes, chance: random.Random) -> bytes:
    """The same text with other line ends, in another encoding, or with parts a second time."""
    lines = data.decode("utf-8", "replace").splitlines()
    if lines and chance.random() < 0.3:  # a section, an element, some frames
        at, to = chance.randrange(len(lines)), chance.randrange(len(lines) + 1)
        lines[to:to] = lines[at : at + chance.choice((1, 7, 7, 60))]
    ends = chance.choice((("\n",), ("\r\n",), ("\r",), ("\n", "\r\n"), ("\n", "\r\n", "\r", "")))
    text = "".join(line + chance.choice(ends) for line in lines)
    if chance.random() < 0.3:
        at = chance.randrange(len(text) + 1)
        text = text[:at] + chance.choice(("µ", "ä", "\x85", "\u2028", "値", "\0", "😀")) + text[at:]
    encoding = chance.choice(("utf-8", "utf-8-sig", "latin-1", "cp1252", "gb2312", "shift_jis",
                              "utf-16", "utf-16-le", "utf-16-be", "utf-32"))
    return text.encode(encoding, "replace")


# ------------------------------------------------------------------------------- the formats

EDS_KEYS = ("ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "LowLimit",
            "HighLimit", "PDOMapping", "SubNumber", "CompactSubObj", "ParameterValue", "ObjFlags",
            "SupportedObjects", "NodeID", "NrOfEntries")
EDS_VALUES = (*NUMBERS, "0x7", "0x8", "0x9", "0x2", "2", "3", "4", "5", "6", "7", "8", "15", "27",
              "ro", "rw", "rww", "rwr", "wo", "const", "0x60400010", "0x60640020", "0x00050008",
              "$NODEID+0x200", "1", "1", "1")
INDICES = (0x1000, 0x1001, 0x1018, 0x1400, 0x1600, 0x1800, 0x1A00, 0x1010, 0x1029, 0x2000, 0x6040,
           0x6041, 0x6060, 0x6061, 0x6064, 0x607A, 0x607D, 0x6081, 0x608F, 0x6091, 0x6092, 0x6098,
           0x60C2, 0x60C5, 0x6502, 0x603F, 0x6071, 0x6075, 0x6080)


def small_eds(chance: random.Random) -> bytes:
    """A data sheet of some objects, each right or nearly so."""
    lines = ["[DeviceInfo]", "ProductName=Small", "[OptionalObjects]"]
    indices = sorted({0x6040, 0x6041, *chance.sample(INDICES, chance.randint(3, 20))})
    lines += [f"{n}=0x{index:04X}" for n, index in enumerate(indices, 1)]
    rows = load("generic").objects
    for index in indices:
        subs = sorted(sub for i, sub in rows if i == index) or [0]
        if subs != [0]:
            lines += [f"[{index:04X}]", f"ParameterName=Group {index}", "ObjectType=9",
                      f"SubNumber={len(subs)}"]
            if chance.random() < 0.1:
                lines += ["CompactSubObj=9", "DataType=7", "AccessType=rw"]
        for sub in subs:
            row = rows.get((index, sub))
            code = row.data_type if row else "UNSIGNED32"
            number = {"UNSIGNED8": 5, "UNSIGNED16": 6, "UNSIGNED32": 7, "INTEGER8": 2,
                      "INTEGER16": 3, "INTEGER32": 4}.get(code, 9)
            if chance.random() < 0.08:
                number = chance.choice((1, 2, 3, 4, 5, 6, 7, 8, 9, 15, 17, 21, 27, 12, 99))
            lines += [f"[{index:04X}sub{sub:X}]" if subs != [0] else f"[{index:04X}]",
                      f"ParameterName={row.name if row else 'own'}", "ObjectType=7",
                      f"DataType={number}", f"AccessType={row.access if row else 'rw'}",
                      f"PDOMapping={int(bool(row and row.pdo))}"]
            if row is not None and row.format:
                lines.append(f"DefaultValue={row.default:g}" if row.format in "fd"
                             else f"DefaultValue={row.default}")
            while chance.random() < 0.1:
                lines.append(f"{chance.choice(EDS_KEYS)}={chance.choice(EDS_VALUES)}")
    return "\n".join(lines).encode()


def small_dcf(chance: random.Random) -> bytes:
    """A configuration: the same with values and a node-id."""
    text = small_eds(chance).decode()
    text = re.sub(r"(DefaultValue=.*)", lambda m: m[1] + (
        f"\nParameterValue={chance.choice(EDS_VALUES)}" if chance.random() < 0.2 else ""), text)
    node = chance.choice(("5", "0x7F", "0", "128", *NUMBERS))
    return f"[DeviceComissioning]\nNodeID={node}\nBaudrate=1000\n{text}".encode()


ESI_TAGS = ("Device", "Type", "Name", "Dictionary", "DataTypes", "DataType", "SubItem", "Objects",
            "Object", "Index", "SubIndex", "BitSize", "BitLen", "Info", "DefaultData",
            "DefaultValue", "Flags", "Access", "PdoMapping", "Fmmu", "Sm", "RxPdo", "TxPdo",
            "Entry", "Exclude", "Mailbox", "CoE", "EoE", "Dc", "OpMode", "AssignActivate", "Eeprom",
            "ByteSize", "ConfigData", "BootStrap", "ArrayInfo", "LBound", "Elements", "BaseType",
            "MinValue", "MaxValue", "Profile", "Vendor", "Id", "GroupType", "BitOffs", "SubIdx")
ESI_VALUES = (*NUMBERS, "UINT", "DINT", "SINT", "BIT", "LREAL", "STRING(8)", "ARRAY [0..9] OF INT",
              "DT6091", "#x6041", "#x607A", "#x6064", "16", "32", "8", "rw", "ro", "R", "T",
              "Outputs", "Inputs", "MBoxState", "MBoxOut", "MBoxIn", "0A0B", "080C0000")


def an_element(chance: random.Random, depth: int) -> str:
    """An element with words of the format, right or wrong in its place."""
    tag = chance.choice(ESI_TAGS)
    attributes = "".join(
        f' {name}="{chance.choice(ESI_VALUES)}"' for name in
        ("ProductCode", "RevisionNo", "Sm", "Fixed", "Mandatory", "StartAddress", "ControlByte",
         "Enable", "DefaultSize", "Physics", "SdoInfo", "PdoAssign", "Factor")
        if chance.random() < 0.12
    )
    if depth and chance.random() < 0.6:
        inner = "".join(an_element(chance, depth - 1) for _ in range(chance.randint(0, 4)))
    else:
        inner = chance.choice(ESI_VALUES)
    return f"<{tag}{attributes}>{inner}</{tag}>\n"


def small_esi(chance: random.Random) -> bytes:
    """A small file of a drive, and elements from elsewhere in some places."""
    def extra(share: float = 0.15) -> str:
        return an_element(chance, 3) if chance.random() < share else ""

    def value(usual: str, share: float = 0.03) -> str:
        return chance.choice(ESI_VALUES) if chance.random() < share else usual

    def pdo(tag: str, index: str, manager: str, rows: tuple[tuple[str, str, str], ...]) -> str:
        entries = "".join(
            f"<Entry><Index>{value(i)}</Index><SubIndex>{value('0')}</SubIndex><BitLen>{value(b)}"
            f"</BitLen><DataType>{value(t)}</DataType></Entry>\n{extra(0.03)}" for i, b, t in rows
        )
        head = f' Sm="{value(manager)}"' if chance.random() < 0.9 else ""
        return f"<{tag}{head}><Index>{value(index)}</Index><Name>n</Name>\n{entries}</{tag}>\n"

    objects = "".join(
        f"<Object><Index>{value(i)}</Index><Name>{n}</Name><Type>{value(t)}</Type><BitSize>"
        f"{value(b)}</BitSize>{extra(0.03)}<Flags><Access>{value(a)}</Access></Flags></Object>\n"
        for i, n, t, b, a in (
            ("#x6040", "cw", "UINT", "16", "rw"), ("#x6041", "sw", "UINT", "16", "ro"),
            ("#x6060", "mode", "SINT", "8", "rw"), ("#x6064", "pos", "DINT", "32", "ro"),
            ("#x607A", "target", "DINT", "32", "rw"), ("#x2000", "own", "DT", "48", "rw"),
        )
    )
    dictionary = f"""<Profile><Dictionary><DataTypes>
<DataType><Name>{value('DT')}</Name><BitSize>{value('48')}</BitSize>
<SubItem><SubIdx>{value('0')}</SubIdx><Name>n</Name><Type>USINT</Type><BitSize>8</BitSize>
<BitOffs>{value('0')}</BitOffs></SubItem>
<SubItem><SubIdx>1</SubIdx><Name>v</Name><Type>{value('DINT')}</Type><BitSize>{value('32')}</BitSize>
<BitOffs>16</BitOffs></SubItem>{extra()}</DataType></DataTypes><Objects>
{objects}</Objects></Dictionary></Profile>""" if chance.random() < 0.7 else extra(0.5)
    mailbox = f"<Mailbox>{extra()}<CoE SdoInfo=\"{value('1')}\"/></Mailbox>"
    return f"""<?xml version="1.0" encoding="{value('utf-8', 0.02)}"?>
<EtherCATInfo>{extra(0.05)}<Vendor><Id>{value('#x1')}</Id><Name>a</Name></Vendor>
<Descriptions>{extra(0.05)}<Devices><Device Physics="{value('YY')}">
<Type ProductCode="{value('#x2')}" RevisionNo="{value('#x3')}">{value('D')}</Type>
<Name>d</Name>{extra()}{dictionary}
<Fmmu>{value('Outputs')}</Fmmu><Fmmu>{value('Inputs')}</Fmmu>
<Sm StartAddress="{value('#x1000')}" DefaultSize="{value('128')}" Enable="1">MBoxOut</Sm>
<Sm StartAddress="{value('#x1400')}" DefaultSize="{value('128')}" Enable="1">MBoxIn</Sm>
<Sm StartAddress="{value('#x1800')}" ControlByte="{value('#x64')}" Enable="1">Outputs</Sm>
<Sm StartAddress="{value('#x1C00')}" ControlByte="{value('#x20')}" Enable="1">Inputs</Sm>
{pdo('RxPdo', '#x1600', '2', (('#x6040', '16', 'UINT'), ('#x607A', '32', 'DINT')))}
{pdo('TxPdo', '#x1A00', '3', (('#x6041', '16', 'UINT'), ('#x6064', '32', 'DINT')))}{extra()}
{mailbox}<Dc><OpMode><Name>DC</Name><AssignActivate>{value('#x300')}</AssignActivate></OpMode></Dc>
<Eeprom><ByteSize>{value('2048')}</ByteSize></Eeprom>{extra()}
</Device></Devices></Descriptions></EtherCATInfo>
""".encode("utf-8", "replace")


def small_sii(chance: random.Random) -> bytes:
    """Categories of an EEPROM, in any order, with lengths that are right or not."""
    image = bytearray(sii.of_model(load(chance.choice(("generic", "kollmorgen_akd")), "ethercat")))
    parts, at = [], sii.CATEGORIES
    while (kind := int.from_bytes(image[at : at + 2], "little")) != sii.END:
        size = 2 * int.from_bytes(image[at + 2 : at + 4], "little")
        parts.append((kind, bytes(image[at + 4 : at + 4 + size])))
        at += 4 + size
    for _ in range(chance.randint(0, 4)):
        n = chance.randrange(len(parts))
        kind, body = parts[n]
        what = chance.randrange(4)
        if what == 0:
            parts.insert(chance.randrange(len(parts) + 1), parts.pop(n))
        elif what == 1:
            parts.append((kind, body))
        elif what == 2:
            parts[n] = (chance.choice((10, 20, 30, 40, 41, 50, 51, 60, 0x800, 0, 0x1234)), body)
        else:
            parts[n] = (kind, bytes_changed(body, chance))
    body = b"".join(struct.pack("<HH", kind, chance.choice((len(b) // 2,) * 20 + (0, 0x7FFF)))
                    + b for kind, b in parts)
    whole = bytes(image[: sii.CATEGORIES]) + body + b"\xff\xff"
    return whole + b"\xff" * (max(len(image), len(whole)) - len(whole))


CAN_LINES = (
    "(1436509052.249713) vcan0 044#2A366C2BBA", "(1.0) can0 181#37020000", "(1.5) can0 601#R",
    "(1.5) can0 601#R8", "(2.0) can0 00000181##11122334455", "(0.0) can0 20000000#0011",
    "  can0  181   [8]  01 02 03 04 05 06 07 08", "  can0  601   [0]  remote request",
    " (000.000123)  can0  TX - -  080   [2]  01 02", "(2024-01-01 10:00:00.5)  can0  080  [0]",
    "candump can0", "$ candump", "^C", "...", "(nan) can0 181#00", "(inf) can0 181#00",
    "(-1.0) can0 181#00", "(1e308) can0 181#00", "can0 181 [9] 00", "(1) c 1#", "#", "(", "181#",
)


def small_candump(chance: random.Random) -> bytes:
    """Lines that candump writes and prints, and others."""
    lines = []
    for n in range(chance.randint(1, 60)):
        if chance.random() < 0.05:
            lines.append(chance.choice(CAN_LINES))
            continue
        identifier = chance.choice((0, 0x80, 0x81, 0x181, 0x201, 0x281, 0x301, 0x581, 0x601, 0x701,
                                    chance.randrange(0x800)))
        data = chance.choice((b"\x40\x41\x60\0\0\0\0\0", b"\x0f\0", b"\x27\x02", chance.randbytes(
            chance.randrange(9)), b"\x80\0\0\0\0\0\2\6"))
        lines.append(f"({n * 0.001:.6f}) can0 {identifier:03X}#{data.hex().upper()}")
    return "\n".join((*lines, "")).encode()


def text_log(suffix: str, source: bytes) -> bytes:
    """A log of candump in another text format of python-can."""
    with tempfile.TemporaryDirectory() as place:
        begin, file = Path(place, "log.log"), Path(place, f"log{suffix}")
        begin.write_bytes(source)
        with can.LogReader(begin) as frames, can.Logger(file) as out:
            for frame in frames:
                out(frame)
        return file.read_bytes()


def printed(source: bytes) -> bytes:
    """A log of candump as candump prints it."""
    rows = (re.fullmatch(r"\((.*)\) (\w+) (\w+)#(\w*)", row)
            for row in source.decode().split("\n"))
    return "\n".join(f" ({row[1]})  {row[2]}  {row[3]}   [{len(row[4]) // 2}]  "
                     + " ".join(re.findall("..", row[4])) for row in rows if row).encode()


def frames(chance: random.Random) -> bytes:
    """Some frames of a bus, as candump logs them."""
    rows = (
        f"({n * 0.001:.6f}) can0 {chance.randrange(0x800):03X}#"
        f"{chance.randbytes(chance.randrange(9)).hex().upper()}\n"
        for n in range(chance.randint(1, 30))
    )
    return "".join(rows).encode()


def small_pcapng(chance: random.Random) -> bytes:
    """Blocks of a capture, with frames that are EtherCAT or not."""
    order = chance.choice("<<<>")

    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        size = 12 + len(body)
        if chance.random() < 0.02:
            size = chance.choice((0, 4, 11, 13, size + 4, 0xFFFFFFFC, 1 << 24))
        return struct.pack(order + "II", kind, size) + body + struct.pack(order + "I", size)

    section = struct.pack(order + "IHHq", pcapng.MAGIC, 1, 0, -1)
    options = struct.pack(order + "HHB3x", 9, 1, chance.choice((6, 9, 9, 0, 0x80, 0x8A, 0xFF, 127)))
    parts = [block(pcapng.SECTION, section)]
    link = struct.pack(order + "HHI", chance.choice((1,) * 20 + (113,)), 0, 0)
    parts.append(block(pcapng.INTERFACE, link + options + bytes(4)))
    for _ in range(chance.randint(0, 12)):
        frame = b"\xff" * 6 + b"\x02" + bytes(5) + b"\x88\xa4"
        for _ in range(chance.choice((1, 1, 2))):
            data = chance.randbytes(chance.choice((0, 1, 2, 4, 16, 64)))
            frame += struct.pack("<H", (len(data) + 12) & 0x7FF | 0x1000)
            frame += struct.pack("<BBHHHH", chance.choice((1, 2, 4, 5, 7, 8, 12, 14, 15)), 0,
                                 chance.choice((0, 0x1001)),
                                 chance.choice((0, 0x10, 0x120, 0x130, 0x502, 0x800, 0x1000)),
                                 len(data), 0) + data + struct.pack("<H", 1)
        kind = chance.choice((pcapng.PACKET,) * 8 + (pcapng.SIMPLE, 4, 5, 0x0BAD))
        length = chance.choice((len(frame),) * 20 + (0, 0xFFFFFFFF))
        if kind == pcapng.PACKET:
            head = struct.pack(order + "IIIII", chance.choice((0,) * 20 + (7,)), 0,
                               chance.randrange(2**32), length, length)
        else:
            head = struct.pack(order + "I", length)
        parts.append(block(kind, head + frame))
    return b"".join(parts)


class Format(NamedTuple):
    """One format: its own files, its generator and its reader."""

    suffix: str
    own: Callable[[], list[bytes]]  # our files
    make: Callable[[random.Random], bytes]
    read: Callable[[Path, Path, bool], object]  # file, folder for the model, the whole way
    words: tuple[str, ...] = ()  # of a text


def _sheet(file: Path, folder: Path, whole: bool) -> object:
    return import_eds(file, folder) if whole else model_of(read_sheet(file))


def _esi(file: Path, folder: Path, whole: bool) -> object:
    if whole:
        return import_esi(file, folder)
    from servogym.drive.ethercat.esi_reader import read_esi

    return read_esi(file)


def _sii(file: Path, folder: Path, whole: bool) -> object:
    if whole:
        return import_sii(file, folder)
    return unpacked(file.read_bytes(), file)


def _log(file: Path, folder: Path, whole: bool) -> object:
    return Source(file, "generic") if whole else [*log.messages(file)]


@functools.cache
def _model() -> DriveModel:
    return load("generic", "ethercat")


def _capture(file: Path, folder: Path, whole: bool) -> object:
    if not whole:
        return [*pcapng.read(file)]
    decoder = EtherCatDecoder(_model())
    return [decoder.decode(packet.frame) for packet in pcapng.read(file)]


def _own_sheets(suffix: str) -> list[bytes]:
    with tempfile.TemporaryDirectory() as place:
        file = Path(place, f"own{suffix}")
        eds.write("generic", file, **({"node_id": 5} if suffix == ".dcf" else {}))
        whole = file.read_bytes()
    chance = random.Random(0)
    small = [small_dcf(chance) if suffix == ".dcf" else small_eds(chance) for _ in range(40)]
    return [whole, *small]


def _own_esi() -> list[bytes]:
    whole = esi.write(esi.of_model(load("generic", "ethercat"))).encode()
    chance = random.Random(0)
    return [whole, *(small_esi(chance) for _ in range(40))]


def _own_captures() -> list[bytes]:
    chance = random.Random(0)
    return [small_pcapng(chance) for _ in range(20)]


def _golden() -> list[bytes]:
    return [(GOLDEN / f"{name}.log").read_bytes()[:6000].rpartition(b"\n")[0] + b"\n"
            for name in ("generic", "festo_cmmd")]


def _text_log(suffix: str, write: Callable[[bytes], bytes], *words: str) -> Format:
    return Format(suffix, lambda: [write(log) for log in _golden()],
                  lambda chance: write(frames(chance)), _log, words)


FORMATS = {
    "eds": Format(".eds", lambda: _own_sheets(".eds"), small_eds, _sheet,
                  ("[", "]", "=", "[6040]", "[1600sub99]", "[6041sub0]", "[1003Name]", *EDS_KEYS)),
    "dcf": Format(".dcf", lambda: _own_sheets(".dcf"), small_dcf, _sheet,
                  ("[", "]", "=", "[6040]", "[1600sub99]", "[2000Value]", *EDS_KEYS)),
    "esi": Format(".xml", _own_esi, small_esi, _esi,
                  ("<", ">", "&amp;", "&x;", "<!DOCTYPE a>", "<![CDATA[", "]]>", "<!--",
                   *(f"<{tag}>" for tag in ESI_TAGS), *(f"</{tag}>" for tag in ESI_TAGS))),
    "sii": Format(".bin", lambda: [sii.of_model(load(model, "ethercat")) for model in MODELS],
                  small_sii, _sii),
    "candump": Format(".log", _golden, small_candump, _log, CAN_LINES),
    "printed": _text_log(".txt", printed, *CAN_LINES),
    "asc": _text_log(".asc", functools.partial(text_log, ".asc"), "base dec  timestamps relative",
                     "base hex  timestamps absolute", "date Sam Jan 1 10:00:00 2022", "// 9",
                     "   0.5 1  181             Rx   d 8 01", "Begin Triggerblock",
                     "  nan 1  x  Rx"),
    "trc": _text_log(".trc", functools.partial(text_log, ".trc"), ";$FILEVERSION=1.1",
                     ";$FILEVERSION=9", ";$STARTTIME=nan", ";$COLUMNS=N,O,T,B,I,d,R,L,D", ";",
                     " 1) 1.0 1 Rx 0181 -  8  01", " 1) 1e400 DT 1 0181 Rx - 2 00 00"),
    "csv": _text_log(".csv", functools.partial(text_log, ".csv"), "timestamp,arbitration_id",
                     ",,,,", "1.0,0x181,0,0,0,9,!!!!", "nan,0x181,0,0,0,1,AA==", "1.0,-1,0,0,0,0,"),
    "pcapng": Format(".pcapng", _own_captures, small_pcapng, _capture),
}


class Found(NamedTuple):
    """What became of all inputs of a format."""

    inputs: int
    read: int
    whole: int  # of them the whole way: a folder of a model, or all frames decoded
    refused: Counter[str]  # refusals by their words, numbers left out
    findings: list[str]


def inputs(kind: str, seed: int, count: int):
    """Inputs of a format."""
    of = FORMATS[kind]
    chance, own = random.Random(f"{kind} {seed}"), of.own()
    for n in range(count):
        data = of.make(chance) if n % 2 else own[chance.randrange(len(own)) if n % 400 else 0]
        if n % 2 == 0 or chance.random() < 0.3:
            how = chance.random()
            if of.words and how < 0.6:
                data = lines_changed(data, chance, of.words)
            elif of.words and how < 0.75:
                data = written_otherwise(data, chance)
            else:
                data = bytes_changed(data, chance)
        yield data


def _said(error: Exception, file: Path) -> str:
    """What is wrong with a refusal, empty if nothing is."""
    said = str(error)
    if not isinstance(error, ValueError):
        return "another exception"
    if "\n" in said:
        return "more than a line"
    if not said.startswith(str(file)):
        return "no file"
    if re.search(r"\w\.(csv|toml)\b", said.removeprefix(str(file))):
        return "a file that is none of the user's"
    return "" if PLACE.search(said) else "no place"


class TooLong(BaseException):
    """More than `LONGEST`."""


def _alarm(*_):
    raise TooLong


def _forget() -> None:
    """Let go of the models that were made: each is kept as long as the process (2 MB)."""
    for cached in gc.get_objects():
        if type(cached) is functools._lru_cache_wrapper and cached.cache_info().currsize > 100:
            cached.cache_clear()


def fuzz(kind: str, place: Path, seed: int, count: int, every: int = 1) -> Found:
    """Read so many inputs; every so-manieth the whole way."""
    of, read, went = FORMATS[kind], 0, 0
    refused: Counter[str] = Counter()
    findings: list[str] = []
    place.mkdir(exist_ok=True)
    before = signal.signal(signal.SIGVTALRM, _alarm)
    try:
        for n, data in enumerate(inputs(kind, seed, count)):
            file, folder = place / f"input{of.suffix}", place / "model"
            file.write_bytes(data)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
            wrong = ""
            try:
                of.read(file, folder, n % every == 0)
                read += 1
            except TooLong:
                wrong = f"more than {LONGEST} s"
            except Exception as error:
                refused[re.sub(r"\d[0-9A-Fa-f]*|'[^']*'|\"[^\"]*\"", "_", str(error).replace(
                    str(file), ""))[:60]] += 1
                wrong = _said(error, file)
                if wrong:
                    where = traceback.extract_tb(error.__traceback__)[-1]
                    wrong += f": {error!r:.300} at {Path(where.filename).name}:{where.lineno}"
            finally:
                signal.setitimer(signal.ITIMER_VIRTUAL, 0)
                went += n % every == 0
                shutil.rmtree(folder, ignore_errors=True)
            if n % 200 == 0:
                _forget()
            if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak > MEMORY >> 10:
                wrong = wrong or "more memory than that"
            if wrong:
                findings.append(f"{n}: {wrong}")
                (place / f"finding_{len(findings)}{of.suffix}").write_bytes(data)
    finally:
        signal.signal(signal.SIGVTALRM, before)
    return Found(count, read, went, refused, findings)


def main() -> None:
    """A table of rounds, written as they end."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("kind", choices=[*FORMATS])
    words.add_argument("--count", type=int, default=1000)
    words.add_argument("--seed", type=int, default=1)
    words.add_argument("--every", type=int, default=1, help="so many are read the whole way")
    words.add_argument("--out", type=Path, required=True)
    options = words.parse_args()
    done, total = 0, Counter()
    with options.out.open("a", newline="") as file:
        table = csv.writer(file)
        while done < options.count:
            count = min(2000, options.count - done)
            found = fuzz(options.kind, options.out.with_suffix(""), options.seed + done, count,
                         options.every)
            done += count
            total.update(found.refused)
            table.writerow((options.kind, options.seed + done - count, count, found.whole,
                            found.read, sum(found.refused.values()), len(found.findings)))
            file.flush()
            for line in found.findings[:20]:
                print(line, flush=True)
    for text, times in total.most_common(30):
        print(f"{times:7} {text}", file=sys.stderr)


if __name__ == "__main__":
    main()
