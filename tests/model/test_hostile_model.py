"""Models from strangers: no circle, no file or nesting that fills the memory, one line each."""

import shutil

import pytest

from servogym.drive.model import files
from servogym.drive.model.model import load


@pytest.fixture
def models(tmp_path):
    """Copies of a model, to be spoilt."""

    def make(*names):
        for name in names:
            shutil.copytree(load("generic").folder, tmp_path / name)
        return [tmp_path / name for name in names]

    return make


def refused(folder, says):
    with pytest.raises(ValueError, match=says) as refusal:
        load(folder)
    assert "\n" not in str(refusal.value)


def before(folder, line):
    """Put a line at the head of its drive.toml."""
    file = folder / "drive.toml"
    file.write_text(line + "\n" + file.read_text(encoding="utf-8"), encoding="utf-8")


def test_models_whose_objects_refer_to_one_another_in_a_circle_are_refused(models):
    one, two, three = models("one", "two", "three")
    before(one, 'objects_of = "../two"')
    before(two, 'objects_of = "../three"')
    before(three, 'objects_of = "../two"')
    refused(one, "objects_of leads back to 'two'")


def test_a_base_whose_objects_refer_to_what_stands_on_it_is_refused(models):
    (base,) = models("base")
    before(base, 'objects_of = "../own"')
    own = base.parent / "own"
    own.mkdir()
    (own / "drive.toml").write_text('based_on = "../base"\n')
    refused(own, "objects_of leads back to 'own'")


def test_bases_in_a_circle_are_refused(models):
    one, two = models("one", "two")
    before(one, 'based_on = "../two"')
    before(two, 'based_on = "../one"')
    refused(one, "based_on leads back to 'one'")


@pytest.mark.parametrize("base", ["/", "/etc/passwd", "../../../../etc", "\\u0000", ""])
def test_a_base_that_is_no_model_is_refused(models, base):
    (one,) = models("one")
    before(one, f'based_on = "{base}"')
    refused(one, "unknown drive model|leads back")


@pytest.mark.parametrize("name", ["drive.toml", "objects.csv", "pdo.csv", "faults.csv"])
def test_a_file_larger_than_any_model_has_is_not_read(models, name):
    (one,) = models("one")
    with (one / name).open("ab") as file:
        file.truncate(files.LARGEST + 1)
    refused(one, f"{name} has {files.LARGEST + 1} bytes, a file of a model has at most")


@pytest.mark.parametrize("nest", ["x = " + "[" * 100_000, "x = " + "{a=" * 100_000])
def test_nesting_without_end_is_refused(models, nest):
    (one,) = models("one")
    before(one, nest)
    refused(one, r"drive\.toml")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ('titel = "My drive"', "titel is unknown: did you mean title"),
        ("[motors]", "motors is unknown: did you mean motor"),
        ('base = "generic"', "base is unknown: did you mean based_on|choose one of"),
        ("[cycle_time_us]\ncurent = 1", "cycle_time_us.curent is unknown: did you mean current"),
        (
            "[motor]\nrotor_inertia = 1",
            "motor.rotor_inertia is unknown: did you mean rotor_inertia",
        ),
        ("[capabilities]\nmode = []", "capabilities.mode is unknown: did you mean modes"),
        ("[quirks]\ntopbit = 1", "quirks.topbit is unknown: did you mean top_bit"),
        ("[units]\ntemperatur = 1", "units.temperatur is unknown: did you mean temperature"),
    ],
)
def test_a_key_that_means_nothing_is_refused_with_a_near_name(tmp_path, line, says):
    (tmp_path / "drive.toml").write_text(f'based_on = "generic"\n{line}\n')
    refused(tmp_path, says)
