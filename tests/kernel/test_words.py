import pytest

from servogym.drive.kernel.words import (
    STATE_PATTERN,
    Command,
    Mode,
    State,
    command_of,
    decode_controlword,
    decode_statusword,
    state_of,
)


@pytest.mark.parametrize("state", State)
def test_every_state_is_recognised_by_its_pattern_alone(state):
    mask, value = STATE_PATTERN[state]
    assert state_of(value) is state
    assert state_of(value | 0xFFFF & ~mask) is state


def test_patterns_never_overlap():
    for word in range(0x80):
        fitting = [s for s, (mask, value) in STATE_PATTERN.items() if word & mask == value]
        assert len(fitting) <= 1


@pytest.mark.parametrize(
    ("word", "command"),
    [
        (0x0000, Command.DISABLE_VOLTAGE),
        (0x000D, Command.DISABLE_VOLTAGE),
        (0x0002, Command.QUICK_STOP),
        (0x000B, Command.QUICK_STOP),
        (0x0006, Command.SHUTDOWN),
        (0x000E, Command.SHUTDOWN),
        (0x0007, Command.SWITCH_ON),
        (0x000F, Command.ENABLE_OPERATION),
    ],
)
def test_command_patterns_of_the_standard(word, command):
    assert command_of(word) is command
    assert command_of(word | 0xFFF0) is command


def test_statusword_bits_are_named_by_mode():
    word = 0x3637
    assert decode_statusword(word, Mode.PROFILE_POSITION) == [
        "OPERATION_ENABLED", "voltage_enabled", "remote", "target_reached",
        "set_point_acknowledge", "following_error",
    ]
    assert decode_statusword(word, Mode.HOMING)[-2:] == ["homing_attained", "homing_error"]
    assert decode_statusword(0x0004)[0] == "INVALID"


def test_controlword_bits_are_named_by_mode():
    assert decode_controlword(0x1F, Mode.HOMING) == ["ENABLE_OPERATION", "homing_operation_start"]
    assert "relative" in decode_controlword(0x5F, Mode.PROFILE_POSITION)
    assert "reference_ramp" in decode_controlword(0x7F, Mode.VELOCITY)
    assert decode_controlword(0x1F, Mode.CYCLIC_SYNC_POSITION)[-1] == "bit_4"
