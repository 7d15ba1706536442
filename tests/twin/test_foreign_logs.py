"""Logs that others have made: what is wrong with one is one line, with what to record instead."""

import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign

from servogym.envs.engine import parameters
from servogym.envs.twin import logs
from servogym.envs.twin.families import FAMILIES
from servogym.envs.twin.fit import refuse
from servogym.envs.twin.regression import regress
from servogym.training.cli import main

RIGID = FAMILIES["rigid"]
TABLE = ("--columns", foreign.COLUMNS)


@pytest.fixture(scope="module")
def rows():
    return foreign.axis()


def usable(file, columns=None):
    """What a fit asks of a log before it begins; -> the experiment, the closed-form stage."""
    joint = parameters.Joint(RIGID.make("generic"), "x")
    (found,) = logs.read([file], RIGID.make("generic"), "generic", "x", columns=columns)
    rough = regress([found], joint.gear)
    refuse([found], rough, joint, RIGID)
    return found, rough


@pytest.mark.parametrize("kind", ["table", "candump"])
def test_a_foreign_log_is_read_and_its_masses_come_out_of_the_closed_form(rows, kind, tmp_path):
    if kind == "table":
        found, rough = usable(foreign.table(tmp_path / "a.csv", rows), foreign.COLUMNS)
    else:
        found, rough = usable(foreign.candump(tmp_path / "a.log", rows))
    assert not found.notes
    assert found.period == pytest.approx(foreign.SAMPLE)
    gear = 2 * 3.141592653589793 / foreign.FEED
    inertia = foreign.ROTOR + foreign.MASS / gear**2
    assert rough.inertia == pytest.approx(inertia, rel=0.05)
    assert rough.coulomb == pytest.approx(foreign.COULOMB / gear, rel=0.1)


def changed(rows, change):
    return [change(n, *row) for n, row in enumerate(rows)]


def still(n, time, asked, place, torque):
    return time, 0.12, 0.12 + 1e-6 * (n % 3), 0.1 + 0.01 * (n % 5)


def onwards(time):
    """Six moves, all in one direction."""
    number, within = divmod(time, 0.9)
    return foreign.cosine(0.06 + 0.06 * number, 0.06, 0.5, within - 0.05)


def wild(time):
    """Moves of a frequency that no motor of this size follows."""
    return 0.25 + 0.12 * foreign.math.sin(2 * foreign.math.pi * 3.0 * time)


def from_rows(change):
    return lambda folder, rows: foreign.table(folder / "a.csv", changed(rows, change))


BAD = {  # what is made of the rows; options; what is said
    "without motion": (from_rows(still), TABLE, "does not move"),
    "without torque": (
        lambda folder, rows: foreign.table(folder / "a.csv", rows),
        ("--columns", foreign.COLUMNS.replace(",torque_actual_value=Drehmoment (Nm):Nm", "")),
        "no torque"),
    "one direction only": (
        lambda folder, rows: foreign.table(folder / "a.csv", foreign.axis(5.4, onwards)), TABLE,
        "one direction"),
    "saturated": (
        lambda folder, rows: foreign.table(folder / "a.csv", foreign.axis(3.0, wild, 3.81)), TABLE,
        "at its limit"),
    "wrong drive": (
        lambda folder, rows: foreign.candump(folder / "a.log", rows),
        ("--drive", "kollmorgen_akd"), "--drive"),
    "torque in a unit that does not fit": (
        from_rows(lambda n, time, asked, place, torque: (time, asked, place, 100 * torque)), TABLE,
        "rated torque"),
    "positions in a unit that does not fit": (
        from_rows(lambda n, time, asked, place, torque: (time, asked, 1e3 * place, torque)), TABLE,
        "travel"),
    "a gap of seconds": (
        lambda folder, rows: foreign.table(
            folder / "a.csv", [row for row in rows if not 1.5 < row[0] < 3.6]), TABLE,
        "nothing was recorded for 2.1 s"),
    "two axes on one bus": (
        lambda folder, rows: foreign.candump(folder / "a.log", rows, (1, 4)), (), "--axis"),
    "two axes mixed in one table": (
        lambda folder, rows: foreign.table(folder / "a.csv", [
            (*row[:3], other[3]) for row, other in zip(rows, rows[700:] + rows[:700], strict=True)
        ]), TABLE, "of one node"),
    "never enabled": (
        lambda folder, rows: foreign.table(folder / "a.csv", rows, status=0x1231), TABLE,
        "enabled"),
    "PDOs of which nobody has seen the mapping": (
        lambda folder, rows: foreign.candump(folder / "a.log", rows, mapped=False), (),
        "record again|begin"),
}


@pytest.mark.parametrize(("make", "options", "said"), BAD.values(), ids=BAD)
def test_what_is_wrong_with_a_foreign_log_is_one_line(make, options, said, rows, tmp_path, capsys):
    log = make(tmp_path, rows)
    out = tmp_path / "twin"
    assert main(["twin", str(log), "--mechanics", "rigid", *options, "-o", str(out)]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert re.search(said, error), error
    assert re.search("record|map|say|give|--", error), error
    assert not (out / "twin.json").exists()


def test_a_foreign_axis_that_was_not_homed_is_a_note(rows, tmp_path):
    far = [(time, asked + 7.0, place + 7.0, torque) for time, asked, place, torque in rows]
    found, _ = usable(foreign.table(tmp_path / "a.csv", far), foreign.COLUMNS)
    assert any("not homed" in note for note in found.notes)
