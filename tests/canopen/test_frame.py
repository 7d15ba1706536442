"""A frame in candump's short form: what it is, and what is refused with the next step."""

import random
import re

import pytest

from servogym.drive.canopen.frame import Frame, parse


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("601#4041600000000000", Frame(0x601, bytes.fromhex("4041600000000000"))),
        ("080#", Frame(0x80)),
        (" 701#R \n", Frame(0x701, remote=True)),
        ("701#r8", Frame(0x701, remote=True)),
        ("00000601#01", Frame(0x601, b"\1", extended=True)),
        ("1FFFFFFF#", Frame(0x1FFFFFFF, extended=True)),
    ],
)
def test_a_frame_is_read(text, frame):
    assert parse(text) == frame


@pytest.mark.parametrize(
    "text",
    ["hello", "", "#", "601", "601#4", "601#zz", "800#", "20000000#", "601#001122334455667788",
     "-1#", "601#R9", "601##1", "0x601#00", "601#40 41", None, 601],
)
def test_what_is_no_frame_is_refused_with_an_example(text):
    with pytest.raises(ValueError, match=f"{re.escape(repr(text))} is not a frame .* 601#40416000"):
        parse(text)


def test_any_text_is_a_frame_or_a_value_error():
    chance = random.Random(3)
    for _ in range(3000):
        text = "".join(chance.choices("0123456789ABCDEFabcdefRr# xg\n", k=chance.randint(0, 24)))
        try:
            frame = parse(text)
        except ValueError:
            continue
        assert parse(str(frame)).data == frame.data
