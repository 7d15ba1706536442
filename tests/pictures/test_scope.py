"""The picture of a motion: everything named, nothing cut off, nothing on top of another."""

import struct
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from later import Later

from servogym.drive.kernel.words import Mode

Figure = Later("matplotlib.figure", "Figure")
draw = Later("servogym.training.pictures.scope", "draw")
round_up = Later("servogym.training.pictures.scope", "round_up")
runs = Later("servogym.training.pictures.scope", "runs")


@dataclass(frozen=True)
class Phase:
    name: str
    start: int
    end: int


PHASES = [
    Phase("power on", 0, 20),
    Phase("enable", 20, 40),
    Phase("home (17)", 40, 400),
    Phase("a move with a rather long name", 400, 420),
    Phase("stop at the end", 990, 1000),
]


def motion(n=1000, window=1000):
    """Channels of the demo for a sine in µm, through three states and two modes."""
    time = np.arange(n) * 5e-4
    position = np.round(1e5 * np.sin(6 * time)).astype(int)
    position[n // 2 :] += 50_000  # the zero is set
    columns = dict.fromkeys(
        ("position_demand_value", "position_actual_value"), position
    ) | dict.fromkeys(
        ("velocity_demand_value", "velocity_actual_value"), np.round(6e5 * np.cos(6 * time))
    )
    return columns | {
        "time": time,
        "following_error_actual_value": np.round(30 * np.sin(50 * time)).astype(int),
        "following_error_window": np.full(n, window, np.uint32),
        "statusword": np.repeat([0x0250, 0x1637, 0x0217], [n // 10, n - n // 5, n // 5 - n // 10]),
        "modes_of_operation_display": np.where(time < 0.25, Mode.HOMING, Mode.PROFILE_POSITION),
        "axis.torque": np.sin(20 * time),
        "axis.torque_limit_positive": np.full(n, 3.8),
        "axis.torque_limit_negative": np.full(n, 2.0),
    }


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """What `draw` drew, and its file: once, for nobody changes it."""
    figures, save = [], Figure.savefig
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", lambda self, *a: (figures.append(self), save(self, *a)))
        path = draw(motion(), PHASES, tmp_path_factory.mktemp("scope") / "scope.png", "a title")
    return figures[0], path


@pytest.fixture
def figure(drawn):
    return drawn[0]


def texts(figure):
    from matplotlib.text import Text

    return {text for text in figure.findobj(Text) if text.get_text()}


def test_the_picture_is_a_png_of_its_size(drawn):
    head = drawn[1].read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", head[16:]) == (1625, 1175)


def test_nothing_is_cut_off(figure):
    for text in texts(figure):
        if not text.get_visible():
            continue
        box = text.get_window_extent()
        assert box.x0 >= 0, text.get_text()
        assert box.y0 >= 0, text.get_text()
        assert box.x1 <= figure.bbox.x1, text.get_text()
        assert box.y1 <= figure.bbox.y1, text.get_text()


def test_no_name_lies_on_another(figure):
    names = {phase.name for phase in PHASES} | {"switch on disabled", "hm", "pp", "a title"}
    boxes = [(t.get_text(), t.get_window_extent()) for t in texts(figure) if t.get_text() in names]
    assert {name for name, _ in boxes} == names
    for i, (name, box) in enumerate(boxes):
        for other, other_box in boxes[i + 1 :]:
            assert not box.overlaps(other_box), f"{name} on {other}"


def test_every_state_is_in_the_key(figure):
    key = [text.get_text() for text in figure.legends[0].get_texts()]
    assert key == ["switch on disabled", "operation enabled", "quick stop active"]


def test_statusword_bits_have_the_names_of_the_modes(figure):
    names = [label.get_text() for label in figure.axes[5].get_yticklabels()]
    assert names == [
        "voltage_enabled  bit 4",
        "warning  bit 7",
        "internal_limit_active  bit 11",
        "target_reached  bit 10",
        "homing_attained  bit 12",
        "set_point_acknowledge  bit 12",
        "homing_error  bit 13",
        "following_error  bit 13",
    ]


def test_every_curve_has_a_unit(figure):
    labels = [panel.get_ylabel() for panel in figure.axes[:4]]
    assert [label.partition("(")[2] for label in labels] == ["mm)", "m/s)", "Nm)", "µm)"]
    assert figure.axes[5].get_xlabel() == "time (s)"


@pytest.mark.parametrize("window", [0, 20, 1000, 0xFFFFFFFF])
def test_the_following_error_window_is_in_sight_unless_it_is_off(tmp_path, monkeypatch, window):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_: drawn.append(self))
    draw(motion(window=window), [], tmp_path / "scope.png", "")
    low, high = drawn[0].axes[3].get_ylim()
    error = np.abs(motion()["following_error_actual_value"]).max()
    assert high > error
    assert low < -error
    if window != 0xFFFFFFFF:
        assert high > window
        assert low < -window


def test_the_recorded_arrays_are_left_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(Figure, "savefig", lambda self, *_: None)
    data = motion()
    before = {name: column.copy() for name, column in data.items()}
    draw(data, PHASES, tmp_path / "scope.png", "")
    for name, column in before.items():
        np.testing.assert_array_equal(data[name], column)


def test_a_single_sample_is_drawn(tmp_path):
    data = {name: column[:1] for name, column in motion().items()}
    assert draw(data, [Phase("enable", 0, 1)], tmp_path / "scope.png", "").is_file()


def test_an_empty_trace_is_refused(tmp_path):
    with pytest.raises(ValueError, match="trace is empty"):
        draw({name: column[:0] for name, column in motion().items()}, [], tmp_path / "x.png", "")


@given(st.floats(0, 1e9))
def test_round_up_leaves_a_little_room(value):
    least = max(value, 1.0)
    assert 1.05 * least <= round_up(value) <= 1.05 * least * 1.5 + 1e-9


@given(arrays(np.int8, st.integers(1, 50), elements=st.integers(0, 2)))
def test_runs_put_together_are_the_values(values):
    spans = runs(values)
    assert [values[first] for first, behind in spans for _ in range(first, behind)] == list(values)
    assert all(values[a] != values[b] for (a, _), (b, _) in pairwise(spans))
