"""The tables of the tasks' docstrings are the records, row by row, and tell the scales."""

import re
from functools import cache

import numpy as np
import pytest

from servogym.envs import TASKS
from servogym.envs.exchange import fields

IDS = [task.ID for task in TASKS]
METRE = 1e6


@cache
def made(task):
    """An environment with all its components, stepped on the way."""
    env = task(axes="xy") if "Sway" in task.ID else task()
    env.reset(seed=2)
    return env


def pattern(name):
    """``"axes[1].velocity"`` -> ``"axes[:].velocity"``."""
    return re.sub(r"\[[\d, ]+\]", lambda m: re.sub(r"\d+", ":", m[0]), name)


def expanded(numbers):
    """``"0, 5"`` -> [0, 5], ``"0–7"`` -> 0 to 7."""
    for part in numbers.split(","):
        first, _, last = part.strip().partition("–")
        yield from range(int(first), int(last or first) + 1)


def table(task, heading):
    """Rows of the table of a section: numbers, name, what, object, scale."""
    section = re.search(rf"## {heading} space\n(.*?)(?=\n    ## )", task.__doc__, re.S)[1]
    for line in section.replace("\\\n", "").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if re.fullmatch(r"[\d, –]+", cells[0]):
            assert len(cells) == 5, line
            yield list(expanded(cells[0])), *cells[1:]


@pytest.mark.parametrize("heading", ["Action", "Observation"])
@pytest.mark.parametrize("task", TASKS, ids=IDS)
def test_each_component_has_one_row_with_its_name(task, heading):
    env = made(task)
    record = env.action_record if heading == "Action" else env.observation_record
    names = fields.names(record)
    width = (env.action_space if heading == "Action" else env.observation_space).shape[0]
    assert len(names) == width == fields.width(record)
    told = {}
    for numbers, name, *_ in table(task, heading):
        for number in numbers:
            told.setdefault(number, []).append(name)
    shown = range(task().observation_space.shape[0] if heading == "Observation" else width)
    assert sorted(told) == list(shown)
    for number, rows in told.items():
        assert pattern(names[number]) in rows, (number, rows)
    if heading == "Observation":
        assert all(len(rows) == 1 for rows in told.values())


def fields_of(record):
    return {name: getattr(record, name) for name in record.dtype.names}


@pytest.mark.parametrize("task", TASKS, ids=IDS)
def test_the_record_and_the_vector_are_the_same_numbers(task):
    env = made(task)
    observation, *_ = env.step(np.full(env.action_space.shape, 0.1, np.float32))
    names = fields.names(env.observation_record)
    found = [eval(name, {}, fields_of(env.named(observation))) for name in names]
    assert found == observation.tolist()


# "1.0 is" in words -> the value of an object of the drive, in the unit of the object observed
SCALES = {
    "the maximum profile velocity 607Fh": "max_profile_velocity",
    "the profile velocity 6081h": "profile_velocity",
    "the maximum torque 6072h": "max_torque",
    "its window 6065h": "following_error_window",
}
OBJECTS = {"606Ch": "velocity_actual_value", "60F4h": "following_error_actual_value",
           "6077h": "torque_actual_value"}


@pytest.mark.parametrize("task", TASKS, ids=IDS)
def test_what_is_seen_of_an_object_is_its_value_over_what_the_table_says_is_one(task):
    env = made(task)
    env.reset(seed=3)
    generator = np.random.default_rng(1)
    names, checked, moved = fields.names(env.observation_record), 0, set()
    for _ in range(40):
        action = generator.uniform(-0.2, 0.2, env.action_space.shape).astype(np.float32)
        observation, _, terminated, *_ = env.step(action)
        assert not terminated
        for numbers, _, _, index, scale in table(task, "Observation"):
            if index[:5] not in OBJECTS or scale not in SCALES or len(index.split()) > 2:
                continue
            for number in numbers:
                place = re.search(r"(?:axes|sides)\[(\d)\]", names[number])
                drive = env.drives[int(place[1]) if place else 0]
                one = drive.read(SCALES[scale])
                value = np.clip(drive.read(OBJECTS[index[:5]]) / one, -1.0, 1.0)
                assert observation[number] == pytest.approx(value, abs=1e-6), names[number]
                checked += 1
                if value:
                    moved.add(number)
    scaled = [row for row in table(task, "Observation") if row[4] in SCALES]
    assert bool(checked) == bool(scaled)
    assert not scaled or "Commissioning" in task.ID or moved


FLAGS = ("active", "active, else 0", "set", "yes, else 0", "at least once")


@pytest.mark.parametrize("task", TASKS, ids=IDS)
def test_flags_are_0_or_1_and_all_else_lies_within_the_box(task):
    env = made(task)
    flags = [n for numbers, *_, scale in table(task, "Observation") if scale in FLAGS
             for n in numbers]
    generator = np.random.default_rng(2)
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        for _ in range(60):
            assert env.observation_space.contains(observation)
            assert set(observation[flags].tolist()) <= {0.0, 1.0}
            observation, *_ = env.step(
                generator.uniform(-0.5, 0.5, env.action_space.shape).astype(np.float32)
            )


def test_a_record_of_records_counts_and_names_all_its_numbers():
    axis = fields.observation("distance", "velocity")
    record = fields.observation("goal", ("ahead", (2, 2)), ("axes", 2, axis))
    assert fields.width(record) == 9
    names = fields.names(record)
    assert names[:6] == ["goal", "ahead[0, 0]", "ahead[0, 1]", "ahead[1, 0]", "ahead[1, 1]",
                         "axes[0].distance"]
    assert fields.slots(record) == {"goal": slice(0, 1), "ahead": slice(1, 5), "axes": slice(5, 9)}
    seen = fields.named(
        record, np.arange(20, dtype=np.float32)
    )  # a history: the latest comes first
    assert (seen.goal, seen.ahead[1, 0], seen.axes[1].velocity) == (0.0, 3.0, 8.0)
    assert fields.width(fields.action("velocity", ("torque", 2))) == 3
