"""The data sheet of a model: what it states is tried, and what does not hold is named."""

import pytest

from servogym.drive.drive import Drive
from servogym.drive.model.model import load, model_names
from servogym.drive.objects.abort import Abort
from servogym.drive.objects.dictionary import ObjectDictionary
from servogym.drive.statements import data_sheet, kind_of, statements
from servogym.training.cli import main


@pytest.mark.parametrize("name", model_names())
def test_what_a_shipped_model_states_holds(name):
    found = [*statements(name)]
    assert [s for s in found if s.wrong] == []
    tried = [s for s in found if s.wrong is not None]
    assert len(tried) > 0.2 * len(found)
    objects = sum(s.text[4:5] == "h" for s in found)
    assert objects == len(load(name).objects)


def test_sources_are_told_apart():
    assert kind_of("CiA 402-2") == "manual or standard"
    assert kind_of("", "inferred from the base") == kind_of("units inferred") == "inferred"
    assert kind_of("EDS") == "file"
    assert kind_of("observed") == "observed"
    assert kind_of("") == "without a source"


def test_a_drive_that_does_not_do_as_its_model_states_is_named(monkeypatch):
    store = ObjectDictionary.store

    def careless(self, slot, value):
        if slot.row.name == "quick_stop_option_code":
            slot.put(value)  # whatever the range is
            return Abort.NONE
        return store(self, slot, value)

    monkeypatch.setattr(ObjectDictionary, "store", careless)
    wrong = [s for s in statements("generic") if s.wrong]
    assert [s.text for s in wrong] == ["605Ah:00h quick_stop_option_code"]
    assert wrong[0].wrong == "-1 is answered by NONE"
    assert "- 605Ah:00h quick_stop_option_code: -1 is answered by NONE" in data_sheet("generic")


def test_a_fault_that_does_not_come_is_named(monkeypatch):
    monkeypatch.setattr(Drive, "inject", lambda self, cause: None)
    assert any(s.wrong == "the drive goes on" for s in statements("generic"))


def test_the_command_prints_the_sheet_and_ends_with_1_where_something_is_wrong(capsys, monkeypatch):
    assert main(["drives", "generic", "--check"]) == 0
    assert "| manual or standard |" in capsys.readouterr().out
    assert main(["drives", "--check"]) == 2
    monkeypatch.setattr(Drive, "inject", lambda self, cause: None)
    assert main(["drives", "generic", "--check"]) == 1
