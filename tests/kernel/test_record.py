"""The record: what its fields are called, and the stub that shows them to editors."""

import functools
import re
import tokenize
from pathlib import Path

import numpy as np
import record_stub

from servogym.drive import kernel
from servogym.drive.kernel.record import AXIS, FIELDS, OBJECTS, OD, accessible, make
from servogym.drive.model.model import load, model_names

SOURCES = sorted(Path(kernel.__file__).parent.rglob("*.py"))
ORDINARY = {"frequency", "inverter", "motor", "positioning", "with", "controller", "two", "axes"}


@functools.cache
def makers():
    """Words of the names and titles of the models that come with the laboratory."""
    words = set()
    for name in model_names():
        words |= set(re.findall(r"[a-z]{3,}", f"{name} {load(name).title}".lower()))
    return words - ORDINARY - set(re.findall(r"[a-z]{3,}", load("generic").title.lower()))


def test_the_stub_is_that_of_the_record():
    assert record_stub.PATH.read_text(encoding="utf-8") == record_stub.text(), "run make stub"


def test_the_stub_has_every_field():
    stub = record_stub.text()
    for dtype in (OD, AXIS):
        for name in dtype.names:
            assert re.search(rf"^    {name}: ", stub, re.M), name


def test_no_field_and_no_flag_speaks_of_a_maker():
    assert {"festo", "metronix", "kollmorgen", "akd", "bonfiglioli", "act"} <= makers()
    for name, _, _, meaning, *_ in (*OBJECTS, *FIELDS):
        words = set(re.findall(r"[a-z]+", f"{name} {meaning}".lower()))
        assert not words & makers(), (name, meaning)
        assert not re.search(r"parameter \d", meaning), (name, "a number of one maker's")


def test_no_name_in_the_kernel_is_a_makers():
    assert SOURCES
    for path in SOURCES:
        with path.open("rb") as file:
            for token in tokenize.tokenize(file.readline):
                if token.type == tokenize.NAME:
                    assert not set(token.string.lower().split("_")) & makers(), (path, token)


def test_equal_dtypes_are_accessible_as_the_same_object():
    """Compiled functions look arrays up by it; with another they compare all fields a call."""
    fields = [("a", "<i4"), ("b", "<f8")]
    assert accessible(np.dtype(fields)) is accessible(np.dtype(fields))
    assert make(2).dtype is make(1).dtype
