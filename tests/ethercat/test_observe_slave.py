"""What is observed of a slave, and what a comparison with a model finds: planted differences."""

import json
import re

import pytest

from servogym.drive.drive import Drive
from servogym.drive.ethercat.bus import Bus
from servogym.drive.ethercat.master import EtherCatMaster
from servogym.drive.ethercat.observe import EtherCatLine, of_model
from servogym.drive.ethercat.segment import Segment
from servogym.drive.ethercat.slave import Slave
from servogym.drive.machine import Standing
from servogym.drive.model.model import load, model_names
from servogym.drive.observation import Observer, compare, opened
from servogym.training.cli import main

MODELS = [name for name in model_names() if "ethercat" in load(name).buses]
GENERIC = load("generic", "ethercat").folder
HEADER = (GENERIC / "objects.csv").read_text(encoding="utf-8").split("\n")[0]

# rows planted in objects.csv, and the object where each shows
ROWS = {
    "vendor": ("0x1018,0x01,,,,,,,,,0x1A3,,,,,,", "1018h:01h"),
    "product": ("0x1018,0x02,,,,,,,,,7,,,,,,", "1018h:02h"),
    "revision": ("0x1018,0x03,,,,,,,,,8,,,,,,", "1018h:03h"),
    "device name": ("0x1008,0x00,,,,,,,,,somebody's drive,,,,,,", "1008h:00h"),
    "device type": ("0x1000,0x00,,,,,,,,,0x00060192,,,,,,", "1000h:00h"),
    "following error window": ("0x6065,0x00,,,,,,,,,5000,,,,,,", "6065h:00h"),
    "position window": ("0x6067,0x00,,,,,,,,,77,,,,,,", "6067h:00h"),
    "an object more": ("0x5000,0x00,extra,VAR,UNSIGNED16,ro,,,,,5,,,,,,", "5000h:00h"),
    "a string more": ("0x4F00,0x00,text,VAR,VISIBLE_STRING,const,,,,,abc,,,,,,", "4F00h:00h"),
    "quick stop range": ("0x605A,0x00,,,,,,,,6,,,,,,,", "605Ah:00h"),
    "velocity range": ("0x6081,0x00,,,,,,,,90000000,,,,,,,", "6081h:00h"),
    "acceleration range": ("0x6083,0x00,,,,,,,10,,,,,,,,", "6083h:00h"),
    "time-out range": ("0x6066,0x00,,,,,,,,1000,,,,,,,", "6066h:00h"),
    "quick stop access": ("0x6085,0x00,,,,ro,,,,,,,,,,,", "6085h:00h"),
    "option access": ("0x605C,0x00,,,,ro,,,,,,,,,,,", "605Ch:00h"),
    "another name": ("0x6087,0x00,slope_of_torque,,,,,,,,,,,,,,", "6087h:00h, entry"),
}
# lines of ethercat.toml, what is planted, and where it shows
LINES = {
    "name": ('name = "Generic CiA 402 drive"', 'name = "Somebody\'s"', "EEPROM, name"),
    "order": ('order = "generic"', 'order = "SD-1"', "EEPROM, order"),
    "mailbox": ("[0x1000, 256, 0x1400, 256]", "[0x1000, 128, 0x1400, 128]", "EEPROM, mailbox"),
    "protocols": ('["CoE", "FoE"]', '["CoE"]', "EEPROM, protocols"),
    "start of outputs": ("[0x1800, 0x1C00]", "[0x1900, 0x1D00]", "EEPROM, sync_managers"),
    "EEPROM": ("size = 4096", "size = 2048", "EEPROM, size"),
    "controller": ('0x0000 = "11"', '0x0000 = "C0"', "register 0000h"),
    "FMMUs": ('0x0004 = "08"', '0x0004 = "03"', "register 0004h"),
    "fixed PDOs": ("[sii]", "[pdo]\nmappable = [4, 2]\n[sii]", "EEPROM, 1A02h"),
}
TABLES = """
[capabilities]
modes = ["pp", "vl", "pv", "hm", "ip", "csp", "csv", "cst"]
homing_methods = [17, 18, 35, 37]
[abort_codes]
"06070012h" = { value = 0x06070010, source = "planted" }
[quirks]
remote_bit = { value = 1, source = "planted" }
"""
SHOWS = {
    "mode tq": "mode 4", "homing methods": "6098h:00h", "abort code": "6060h:00h 5 bytes",
    "remote bit": "controlword 0006h", "without 60F2h": "60F2h:00h", "without 60D8h": "60D8h:00h",
}
# what else a planted difference shows in: descriptions, lists, the EEPROM, lengths of strings
ALSO = re.compile(
    r"EEPROM, (vendor_id|product_code|revision_number|coe_details|foe_details|protocols|mailbox|"
    r"sync_managers|bootstrap|1A0[23]h)|register 000[04]h|lengths of the lists|objects .*|"
    r"(5000|4F00|605A|605C|6081|6083|6085|6087|6066|60F2|60D8|1A0[23]|1008)h.*, (entry|object)|"
    r"1A0[23]h:..h.*|60E3h:..h.*|6502h:00h|6041h:00h|controlword .*|....h:..h . bytes|"
    r"complete access of 1018h|60D8h:..h|60E3h, object|1C1[23]h:..h"
)


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """A folder with all of it, and by plant where it shows."""
    folder = tmp_path_factory.mktemp("slave") / "real"
    folder.mkdir()
    rows = "\n".join([HEADER, *(row for row, _ in ROWS.values())])
    (folder / "objects.csv").write_text(rows + "\n", encoding="utf-8")
    (folder / "drive.toml").write_text(
        'based_on = "generic"\nwithout = ["60F2h", "60D8h"]\n' + TABLES, encoding="utf-8"
    )
    text = (GENERIC / "ethercat.toml").read_text(encoding="utf-8")
    for name, (old, new, _) in LINES.items():
        assert old in text, name
        text = text.replace(old, new, 1)
    (folder / "ethercat.toml").write_text(text, encoding="utf-8")
    for file in ("ethercat_objects.csv", "ethercat_pdo.csv"):
        (folder / file).write_bytes((GENERIC / file).read_bytes())
    shows = {name: where for name, (_, where) in ROWS.items()}
    shows |= {name: where for name, (*_, where) in LINES.items()}
    return folder, shows | SHOWS


def test_planted_differences_are_found_and_none_is_invented(planted):
    folder, shows = planted
    assert len(shows) >= 30
    differences = compare(of_model(folder), of_model("generic"))
    where = {difference.where for difference in differences}
    assert [name for name, place in shows.items() if place not in where] == []
    assert [w for w in where - set(shows.values()) if not ALSO.fullmatch(w)] == [], "invented"


@pytest.mark.parametrize("name", MODELS)
def test_an_observed_model_gives_back_that_model(name):
    found = of_model(name)
    assert found["read_only"] == ""
    assert compare(found, of_model(name)) == []
    assert not any("not_restored" in one for one in found["objects"].values())
    assert len(found["dialogues"]) >= 100
    assert opened(json.dumps(found), "x") == found


def test_nothing_is_written_to_a_slave_that_is_enabled_nor_beside_it():
    drives = [Drive(load("generic", "ethercat")) for _ in range(2)]
    cycling = Standing({str(n): drive for n, drive in enumerate(drives)}, 0.00025)
    master = EtherCatMaster(Bus(Segment([Slave(drive) for drive in drives])))
    slaves = master.scan()
    master.to_preop()
    for word in (0x06, 0x07, 0x0F):
        drives[1].write("controlword", word)
        cycling.step(200)
    before = [{(i, s): d.objects.read(i, s) for i, s in d.objects.slots} for d in drives]
    for position in (0, 1):
        line = EtherCatLine(slaves, position, lambda time: cycling.step(round(time / 0.00025)))
        found = Observer(line).observe()
        assert found["read_only"] == "slave 1 is in OPERATION_ENABLED"
        assert not any("write" in one for one in found["objects"].values())
        told = " ".join(found["dialogues"])
        assert "AL state" not in told
        assert "controlword" not in told
    after = [{(i, s): d.objects.read(i, s) for i, s in d.objects.slots} for d in drives]
    assert before == after


def test_a_comparison_proposes_a_model_that_says_more_of_the_same(planted, tmp_path, capsys):
    folder, _ = planted
    file, out = tmp_path / "real.json", tmp_path / "mine"
    file.write_text(json.dumps(of_model(folder)))
    assert main(["observe", "--compare", str(file), "--drive", "generic", "-o", str(out)]) == 1
    assert "marked observed" in capsys.readouterr().out
    objects = re.compile(r"(10|[2-6].)..h:..h")  # those of which a row can say it

    def differing(model):
        found = {difference.where for difference in compare(of_model(folder), of_model(model))}
        return {where for where in found if objects.fullmatch(where)}

    assert len(differing(out)) <= len(differing("generic")) / 4
