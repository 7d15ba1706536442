"""Per drive model one scripted commissioning, replayed: the drives answer as they did, bit by bit.

`golden/record.py` has recorded the logs and records them anew.
"""

from itertools import zip_longest

import can
import pytest
from golden.ethercat_master import FRAME
from golden.record import HERE, LOGS
from golden.rig import CanRig, rig

from servogym.drive.canopen.decode import Decoder
from servogym.drive.canopen.frame import parse
from servogym.drive.model.model import load, model_names
from servogym.drive.wire.bus import to_frame

CAN = [model for model in LOGS if load(model).bus == "can"]
HINT = "if this is meant: cd tests; python -m golden.record"
SIZE = 60_000  # bytes of a log at most


def lines_of(model):
    return (HERE / LOGS[model]).read_text().splitlines()


class Meaning:
    """What the lines of a log mean, one after the other."""

    def __init__(self, model):
        self._on_can = load(model).bus == "can"
        self._decoder = Decoder(model) if self._on_can else None

    def __call__(self, line):
        if line is None:
            return "nothing"
        _, channel, frame, _ = line.split()
        if self._decoder:
            return f"{line}  {self._decoder.decode(parse(frame))}"
        if channel != "mailbox":
            return line
        _, _, _, _, _, command, index, subindex, data = FRAME.unpack(bytes.fromhex(frame))
        return f"{line}  SDO {command:02X}h {index:04X}h:{subindex:02X}h {data.hex(' ')}"


def difference(model, expected, got):
    """The first line that is not as recorded, with its meaning; empty if all are."""
    recorded, now = Meaning(model), Meaning(model)
    for number, (a, b) in enumerate(zip_longest(expected, got), 1):
        was, is_ = recorded(a), now(b)
        if a != b:
            return f"{LOGS[model]}:{number}\n  recorded: {was}\n  now:      {is_}\n{HINT}"
    return ""


@pytest.mark.parametrize("model", LOGS)
def test_a_drive_answers_its_commissioning_as_recorded(model):
    expected = lines_of(model)
    changed = difference(model, expected, rig(model).replay(expected))
    assert not changed, changed


def test_every_drive_model_has_a_recorded_commissioning():
    assert set(LOGS) == set(model_names())


@pytest.mark.parametrize("model", LOGS)
def test_a_log_is_small_and_its_time_does_not_go_back(model):
    assert (HERE / LOGS[model]).stat().st_size <= SIZE
    times = [float(line.split()[0][1:-1]) for line in lines_of(model)]
    assert times == sorted(times)


@pytest.mark.parametrize("model", CAN)
def test_python_can_reads_the_frames_and_directions_of_a_log(model):
    with can.LogReader(HERE / LOGS[model]) as reader:
        read = [(to_frame(message), "TR"[message.is_rx]) for message in reader]
    lines = [line.split() for line in lines_of(model)]
    assert read == [(parse(frame), direction) for _, _, frame, direction in lines]


@pytest.mark.parametrize("model", CAN)
def test_decode_knows_every_frame_but_the_causes_of_faults(model):
    decoder = Decoder(model)
    frames = [parse(line.split()[2]) for line in lines_of(model)]
    texts = [(frame, decoder.decode(frame)) for frame in frames]
    unknown = {frame.id for frame, text in texts if text.startswith("unknown")}
    assert unknown == {0x1FFF_FF01}


def test_a_changed_bit_is_told_with_its_meaning():
    lines = lines_of("generic")
    number = next(i for i, line in enumerate(lines) if " 181#37" in line)
    changed = [*lines]
    changed[number] = lines[number].replace("181#37", "181#27")
    told = difference("generic", lines, changed)
    assert f"generic.log:{number + 1}" in told
    assert "statusword=0227h OPERATION_ENABLED" in told
    assert "now:      nothing" in difference("generic", lines, lines[:-1])


def test_a_frame_of_the_master_that_is_missing_changes_the_answers():
    lines = lines_of("generic")[:61]
    assert difference("generic", lines, CanRig("generic").replay(lines)) == ""
    missing = lines.pop(5)
    assert missing.endswith(" T")
    assert "SDO[1] read" in difference("generic", lines, CanRig("generic").replay(lines))
