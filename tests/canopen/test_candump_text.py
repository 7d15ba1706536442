"""What candump prints, as it stands in forums: the same frames as in its log."""

import pytest

from servogym.drive.wire.log import APART, messages
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
