"""What candump prints, as it stands in forums: the same frames as in its log."""

import re

import pytest

from servogym.drive.wire.log import messages
from servogym.drive.wire.text_log import APART
from servogym.training import cli

# the forms of can-utils' candump (sprint_long_canframe, candump.c), typed anew
LOGGED = """\
(1700000000.000100) can0 000#8205
(1700000000.001100) can0 705#00
(1700000000.001300) can0 605#4041600000000000
(1700000000.002000) can0 585#4B41600040020000
(1700000000.003000) can0 080#
(1700000000.004000) can0 705#R1
"""
PRINTED = [
    "  can0  000   [2]  82 05",
    "  can0  705   [1]  00",
    "  can0  605   [8]  40 41 60 00 00 00 00 00",
    "  can0  585   [8]  4B 41 60 00 40 02 00 00",
    "  can0  080   [0] ",
    "  can0  705   [1]  remote request",
]
TIMES = [0.0001, 0.0011, 0.0013, 0.002, 0.003, 0.004]


def stamped(form):
    lines, before = [], 0.0
    for line, time in zip(PRINTED, TIMES, strict=True):
        text = {
            "a": f"{1700000000 + time:.6f}",
            "A": f"2023-11-14 22:13:20.{round(time * 1e6):06d}",
            "z": f"{time:010.6f}",
            "d": f"{time - before:010.6f}",
        }[form]
        before = time
        lines.append(f" ({text}){line}")
    return lines


def ascii_beside(line):
    return f"{line:45}'@A`.....'"


FORMS = {
    "candump can0": PRINTED,
    "-t a": stamped("a"),
    "-t A": stamped("A"),
    "-t z": stamped("z"),
    "-t d": stamped("d"),
    "-x": [line.replace("can0  ", "can0  RX - -  ") for line in PRINTED],
    "-a": [ascii_beside(line) for line in PRINTED],
    "without spaces in front": [line.strip() for line in PRINTED],
    "CRLF": [line + "\r" for line in PRINTED],
    "in a terminal": ["pi@raspberrypi:~ $ candump can0", *PRINTED, "^C"],
    "after a prompt": ["$ candump -t a can0", *stamped("a"), "...", ""],
    "with comments": [f"{line}   # a remark {n}" for n, line in enumerate(PRINTED)],
    "in a fence": ["```", *PRINTED, "```"],
    "quoted": [f"> {line}" for line in PRINTED],
    "-c": [f"\x1b[31m{line}\x1b[0m" for line in PRINTED],
    "-8": [line.replace("[8]", "{8}") for line in PRINTED],
    "in the background": ["pi@raspberrypi:~ $ candump can0 &", "[1] 1234", *PRINTED],
    "of the older canutils": [
        "interface = can0, family = 29, type = 3, proto = 1",
        *[re.sub(r"  can0  (\w+) ", r"<0x\1>", line) for line in PRINTED],
    ],
    "UTF-8 with a mark": ["\ufeff" + PRINTED[0], *PRINTED[1:]],
}


def written(path, lines):
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def shown(path):
    return [
        (m.arbitration_id, bytes(m.data), m.is_remote_frame, m.dlc, m.is_extended_id)
        for m in messages(path)
    ]


@pytest.mark.parametrize("suffix", [".log", ".txt"])
@pytest.mark.parametrize("form", FORMS)
def test_what_candump_prints_are_the_frames_of_its_log(tmp_path, form, suffix):
    logged = tmp_path / "logged.log"
    logged.write_text(LOGGED)
    assert shown(written(tmp_path / f"run{suffix}", FORMS[form])) == shown(logged)


@pytest.mark.parametrize("form", ["-t a", "-t A", "-t z", "-t d"])
def test_times_that_are_printed_are_those_of_the_log(tmp_path, form):
    stamps = [m.timestamp for m in messages(written(tmp_path / "run.log", FORMS[form]))]
    begin = 1700000000 if form in ("-t a", "-t A") else 0
    assert stamps == pytest.approx([begin + time for time in TIMES], abs=2e-6)


def test_a_console_that_writes_utf_16_is_read(tmp_path):
    logged, wide = written(tmp_path / "logged.log", LOGGED.splitlines()), tmp_path / "wide.log"
    wide.write_text(LOGGED, "utf-16")
    assert shown(wide) == shown(logged)


@pytest.mark.parametrize(
    "line",
    ["  can0  20000004   [8]  00 08 00 00 00 00 00 00   ERRORFRAME",
     "can0 20000204#0008000000000000"],
)
def test_an_error_frame_of_any_class_is_one_and_its_words_are_left_out(tmp_path, line):
    rows = [PRINTED[0], line, "\tcontroller-problem{tx-error-warning}", PRINTED[1]]
    if "#" in line:
        rows = [LOGGED.splitlines()[0], f"(1700000000.000500) {line}", LOGGED.splitlines()[1]]
    read = [*messages(written(tmp_path / "run.log", rows))]
    assert [m.is_error_frame for m in read] == [False, True, False]


# a log of CANoe: the same frames; numbers, header and times as its settings make them
HEADER = """\
date Mit Mär 3 10:06:13.191 2017
base {base}  timestamps {times}
internal events logged
// version 9.0.0
Begin Triggerblock Mit Mär 3 10:06:13.191 2017
   0.000000 Start of measurement
"""
EVENTS = [(0x000, "8205"), (0x705, "00"), (0x605, "4041600000000000"), (0x585, "4B41600040020000")]


def of_vector(base, relative):
    for (identifier, data), time, before in zip(EVENTS, TIMES, (0.0, *TIMES), strict=False):
        numbers = [identifier, *bytes.fromhex(data)]
        texts = [str(number) if base == "dec" else f"{number:X}" for number in numbers]
        stamp = time - before if relative else time
        yield (f"   {stamp:.6f} 1  {texts[0]}             Rx   d {len(texts) - 1} "
               + " ".join(texts[1:]) + f"  Length = 0 BitCount = 64 ID = {identifier}")


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
@pytest.mark.parametrize("times", ["absolute", "relative"])
@pytest.mark.parametrize("base", ["hex", "dec"])
@pytest.mark.parametrize("cut", ["", "date", "blank", "all"])
def test_an_asc_is_read_whatever_its_header(tmp_path, base, times, encoding, cut):
    if cut == "all" and (base, times) != ("hex", "absolute"):
        return  # nothing tells
    head = HEADER.format(base=base, times=times)
    head = {"": head, "date": head.split("\n", 1)[1], "blank": head.replace("\nbase", "\n\nbase"),
            "all": ""}[cut]
    file = tmp_path / "run.asc"
    file.write_bytes((head + "\n".join(of_vector(base, times == "relative")) + "\n")
                     .encode(encoding))
    read = [*messages(file)]
    assert [(m.arbitration_id, m.data.hex().upper()) for m in read] == EVENTS
    assert [m.timestamp for m in read] == pytest.approx(TIMES[:4], abs=3e-6)


def test_a_version_of_trc_that_is_not_read_is_named(tmp_path):
    lines = [";$FILEVERSION=1.2", "     1)       0.000 1  Rx     0000  2  82 05"]
    with pytest.raises(ValueError, match=r"version 1\.2 of this format is not read, save it as"):
        shown(written(tmp_path / "run.trc", lines))


def test_frames_without_times_keep_their_order(tmp_path):
    stamps = [m.timestamp for m in messages(written(tmp_path / "run.log", PRINTED))]
    assert stamps == pytest.approx([APART * (n + 1) for n in range(6)])


def test_extended_identifiers_error_frames_and_can_fd(tmp_path):
    lines = [
        "  can0  1000107E   [8]  30 01 6C 68 84 64 2D A4",
        "  can0  20000088   [8]  00 00 00 19 00 00 00 00   ERRORFRAME",
        "  can0  123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B",
    ]
    extended, error, fd = messages(written(tmp_path / "run.log", lines))
    assert extended.is_extended_id
    assert extended.arbitration_id == 0x1000107E
    assert error.is_error_frame
    assert fd.is_fd
    assert bytes(fd.data) == bytes(range(12))


@pytest.mark.parametrize(
    "line",
    [
        "  can0  123   [8]  00 11 22",
        "  can0  123   [8]  00 11 22 33 44 55 66 GG",
        "  can0  12    [1]  00",
        "  (soon)  can0  123   [1]  00",
        "  can0  280   [0]  683   [4]  00 0NMT0 00",
        "hello world",
    ],
)
def test_a_line_that_is_damaged_is_told_with_its_number(tmp_path, line, capsys):
    file = written(tmp_path / "run.log", [*PRINTED, line])
    if line.startswith("  can0  280"):  # what lies behind the bytes is candump's own or a remark
        assert len(shown(file)) == 7
        return
    with pytest.raises(ValueError, match=r"run\.log, line 7: damaged"):
        shown(file)


def test_decode_reads_it_as_it_stands_in_a_forum(tmp_path, capsys):
    assert cli.main(["decode", str(written(tmp_path / "run.txt", FORMS["in a terminal"]))]) == 0
    said = capsys.readouterr().out
    assert "statusword" in said
    assert "0240h" in said
