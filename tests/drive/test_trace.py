"""The oscilloscope: channels, the ring buffer, the trigger, the files."""

import csv
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servogym.drive.drive import Drive
from servogym.drive.trace import Edge, Trace, Trigger

CHANNEL = "target_position"
values = st.lists(st.integers(-1000, 1000), min_size=1, max_size=40)


def record(samples, **options):
    """A trace of `samples` written to one object, one every 0.5 ms."""
    trace = Trace(DRIVE, [CHANNEL], **options)
    for number, value in enumerate(samples):
        DRIVE.write(CHANNEL, value)
        trace.sample(number * 5e-4)
    return trace


DRIVE = Drive("generic")


def test_an_object_is_in_drive_units_and_a_field_in_si():
    drive = Drive("generic")
    trace = Trace(drive, [CHANNEL, "axis.target_position", "axis.state"])
    drive.write(CHANNEL, 1000)
    drive.cycle(0.0, 0.0)
    trace.sample(0.0)
    arrays = trace.arrays()
    radians = 1000 * drive.axis.rad_per_position_unit
    assert arrays[CHANNEL].tolist() == [1000]
    assert arrays["axis.target_position"].tolist() == pytest.approx([radians])
    assert trace.units["axis.target_position"] == "rad"
    assert arrays["axis.state"].tolist() == [drive.state]


def test_channels_of_the_second_axis_are_its_own():
    from servogym.drive.kernel import record as axis_record

    axes = axis_record.make(2)
    first, second = Drive("generic", axes=axes, index=0), Drive("generic", axes=axes, index=1)
    trace = Trace(second, [CHANNEL])
    first.write(CHANNEL, 1)
    second.write(CHANNEL, 2)
    trace.sample(0.0)
    assert trace.arrays()[CHANNEL].tolist() == [2]


@pytest.mark.parametrize("name", ["", "no_such_object", "axis.od", "axis.nothing", "axis.", "x"])
def test_an_unknown_channel_is_refused_with_an_example(name):
    with pytest.raises(ValueError, match="position_actual_value"):
        Trace(DRIVE, [name])


def test_an_empty_trace_has_empty_columns():
    arrays = Trace(DRIVE, [CHANNEL]).arrays()
    assert {name: len(column) for name, column in arrays.items()} == {"time": 0, CHANNEL: 0}


@given(values, st.integers(1, 50))
def test_without_a_trigger_the_last_samples_are_kept(samples, depth):
    trace = record(samples, depth=depth)
    kept = samples[-depth:]
    assert trace.arrays()[CHANNEL].tolist() == kept
    assert len(trace) == len(kept)
    first = len(samples) - len(kept)
    assert trace.arrays()["time"].tolist() == [
        number * 5e-4 for number in range(first, len(samples))
    ]


EVENTS = {
    Edge.RISING: lambda before, now, level: before is not None and before < level <= now,
    Edge.FALLING: lambda before, now, level: before is not None and before > level >= now,
    Edge.ABOVE: lambda before, now, level: now >= level,
    Edge.CHANGE: lambda before, now, level: before is not None and before != now,
}


@given(values, st.sampled_from(Edge), st.integers(-1000, 1000), st.integers(0, 5))
def test_a_trigger_keeps_the_samples_around_the_first_event(samples, edge, level, before):
    depth = before + 8
    trace = record(samples, depth=depth, before=before, trigger=Trigger(CHANNEL, edge, level))
    pairs = enumerate(zip([None, *samples[:-1]], samples, strict=True))
    event = next((i for i, (old, new) in pairs if EVENTS[edge](old, new, level)), None)
    assert trace.triggered == (event is not None)
    if event is None:
        assert not trace.done
        return
    begin = max(event - before, 0)
    kept = samples[begin : begin + depth]
    assert trace.arrays()[CHANNEL].tolist() == kept
    assert trace.done == (len(kept) == depth)


@pytest.mark.parametrize(
    "options",
    [
        {"depth": 0},
        {"trigger": Trigger(CHANNEL, Edge.CHANGE)},
        {"trigger": Trigger(CHANNEL, Edge.CHANGE), "depth": 5, "before": 5},
        {"trigger": Trigger(CHANNEL, Edge.CHANGE), "depth": 5, "before": -1},
        {"trigger": Trigger("nothing", Edge.CHANGE), "depth": 5},
    ],
)
def test_a_buffer_that_cannot_be_is_refused(options):
    with pytest.raises(ValueError, match=r"depth|channel"):
        Trace(DRIVE, [CHANNEL], **options)


def test_csv_has_units_in_its_header_and_every_digit(tmp_path):
    trace = record([1, -2, 3])
    trace.save(tmp_path / "trace.csv")
    with (tmp_path / "trace.csv").open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    assert header[0] == "time (s)"
    assert header[1].startswith(CHANNEL)
    assert [(float(t), int(value)) for t, value in rows] == [(0.0, 1), (5e-4, -2), (1e-3, 3)]


def test_npz_gives_the_arrays_back(tmp_path):
    trace = record([1, -2, 3])
    trace.save(str(tmp_path / "trace.npz"))
    with np.load(tmp_path / "trace.npz") as file:
        arrays = {name: file[name] for name in file.files}
    assert arrays.keys() == trace.arrays().keys()
    for name, column in trace.arrays().items():
        np.testing.assert_array_equal(arrays[name], column)


def test_parquet_without_pyarrow_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ImportError, match="pip install pyarrow"):
        record([1]).save(tmp_path / "trace.parquet")


@pytest.mark.parametrize("name", ["trace", "trace.txt", "trace.CSV"])
def test_an_unknown_suffix_is_refused_with_the_known_ones(tmp_path, name):
    with pytest.raises(ValueError, match=r"\.csv, \.npz"):
        record([1]).save(tmp_path / name)
    assert not (tmp_path / name).exists()
