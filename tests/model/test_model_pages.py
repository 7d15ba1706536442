"""Each drive model has a page: what is inferred, what is missing, every quirk of its manual.

The pages are prose; what can be counted is checked here.
"""

import re
import tomllib
from pathlib import Path

import pytest

from servogym.drive.kernel.record import OD
from servogym.drive.model.model import load, model_names
from servogym.training import cli

DRIVES = (Path(__file__).parents[2] / "docs/reference/drives.md").read_text(encoding="utf-8")
HEADINGS = ("**What is inferred**", "**What is not supported**")
# model -> items in each table of quirks, as many as its manual has
QUIRK_TABLES = {
    "bonfiglioli_act": (25,),
    "festo_cmmp_as": (25, 32, 4),  # communication, motion, CMMS and CMMD
    "generic": (),
    "kollmorgen_akd": (27,),
    "metronix_ars2000": (8, 26),  # departures from CiA 402, contradictions
}
# objects without a field of their own that something reads: transmit masks, error_number
READ_ELSEWHERE = (0x2014, 0x2015, 0x2016, 0x2017, 0x2100)


def text(name):
    return (load(name).folder / "README.md").read_text(encoding="utf-8")


def head(name):
    """The model of a family that has the page."""
    toml = tomllib.loads((load(name).folder / "drive.toml").read_text(encoding="utf-8"))
    return head(toml["based_on"]) if "based_on" in toml else name


def section(name, heading):
    """What stands under a heading, up to the next one of its level."""
    found = re.findall(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", text(name), re.M | re.S)
    assert len(found) == 1, (name, heading)
    return found[0]


def identity(model):
    """Rows of 1018h from the vendor-id on, as many as there are."""
    return [model.objects[0x1018, n] for n in (1, 2, 3, 4) if (0x1018, n) in model.objects]


MODELS = model_names()
HEADS = sorted({head(name) for name in MODELS})


@pytest.mark.parametrize("name", MODELS)
def test_a_model_has_a_page_or_points_to_that_of_its_family(name):
    assert text(name).startswith("# ")
    assert f"(../../assets/drives/{head(name)}/README.md)" in DRIVES
    if name != head(name):
        assert f"(../{head(name)}/README.md)" in text(name)
        assert f"| `{name}` |" in text(head(name))


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize("name", HEADS)
def test_a_page_says_what_is_inferred_and_what_is_not_supported(name, heading):
    assert len(re.findall(r"^- ", section(name, heading), re.M)) >= 5


@pytest.mark.parametrize("name", MODELS)
def test_every_quirk_flag_is_on_the_page(name):
    page = text(head(name))
    assert not [flag for flag in load(name).quirks if f"`{flag}`" not in page]


@pytest.mark.parametrize("name", QUIRK_TABLES)
def test_every_quirk_of_the_manual_has_its_line(name):
    numbers = [int(n) for n in re.findall(r"^\| (\d+) \|", text(name), re.M)]
    assert numbers == [n for items in QUIRK_TABLES[name] for n in range(1, items + 1)]


@pytest.mark.parametrize("name", MODELS)
def test_what_can_be_written_and_does_nothing_is_called_not_supported(name):
    words = section(head(name), HEADINGS[1])
    named = set()
    for first, last in re.findall(r"\b([0-9A-F]{4})h(?:–([0-9A-F]{4})h)?", words):
        named |= {*range(int(first, 16), int(last or first, 16) + 1)}
    vendor = OD.fields["vendor"][1]
    for row in load(name).objects.values():
        idle = row.access in ("rw", "wo") and row.area == "axis" and row.offset >= vendor
        if idle and not row.hook and row.index >= 0x2000 and row.index not in READ_ELSEWHERE:
            assert row.index in named, row.name
            if row.index >> 8 in (0x64, 0x65):  # records of which other parts do something
                assert f":{row.subindex:02X}h" in words, row.name


@pytest.mark.parametrize("name", HEADS)
def test_cycle_times_and_identity_on_the_page_are_those_of_the_model(name):
    model = load(name)
    cycles = ", ".join(f"{n} {t * 1e6:g}" for n, t in model.cycle_time.items())
    assert f"{cycles} µs" in text(name)
    product_or_vendor = identity(model)[:2][-1]
    assert f"{product_or_vendor.default:X}h" in text(name)


@pytest.mark.parametrize("name", MODELS)
def test_drives_tells_identity_bus_axes_quirks_and_page(name, capsys):
    model = load(name)
    assert cli.main(["drives", name]) == 0
    out = capsys.readouterr().out
    for row in identity(model):
        assert f"{row.default:08X}h" in out
    assert re.search(rf"│ bus +│ {', '.join(model.buses)} ", out)
    assert re.search(rf"│ axes +│ {model.axes}\b", out)
    assert str(model.folder / "README.md") in out
    for flag, quirk in model.quirks.items():
        assert f"{flag} = {quirk.value} (" in out
