"""Damaged and made-up files of six formats end with a model or with one line that says where."""

import damaged_files
import pytest


def fuzzed(tmp_path, kind, seed, count):
    found = damaged_files.fuzz(kind, tmp_path / kind, seed, count)
    assert not found.findings, found.findings
    assert 0 < found.read < count  # some are read, and some are refused
    assert found.read + sum(found.refused.values()) == count


@pytest.mark.parametrize("kind", damaged_files.FORMATS)
def test_a_damaged_file_is_read_or_refused_with_its_place(tmp_path, kind):
    fuzzed(tmp_path, kind, 1, 40)


@pytest.mark.slow
@pytest.mark.parametrize("kind", damaged_files.FORMATS)
def test_3000_damaged_files_are_read_or_refused_with_their_place(tmp_path, kind):
    fuzzed(tmp_path, kind, 2, 3000)
