"""Mailbox services of the drives as pysoem has them, on a veth pair."""

import json
import shutil

import pytest
from wire import on_the_wire

from servogym.drive.ethercat.sdo_info import access, bits, members, object_name
from servogym.drive.model.model import load
from servogym.drive.model.rows import DATA_TYPES

AKD = ("--drive", "kollmorgen_akd", "--axis", "none")
GENERIC = ("--drive", "generic", "--axis", "none")
SDO_ERROR = "SdoError"


@pytest.fixture(scope="module")
def akd():
    return on_the_wire("pysoem_services", "sdo", *AKD)


def test_22_a_refused_write_is_an_sdo_error_with_the_code_of_the_drive(akd):
    assert akd["read_only"] == [SDO_ERROR, 0x06010002]
    assert akd["wrong_value"] == [SDO_ERROR, 0x06090030]
    assert akd["missing"] == [SDO_ERROR, 0x06020000]
    assert akd["too_long"] == [SDO_ERROR, 0x06070012]
    assert akd["accepted"] == ["accepted", 0]


def test_23_a_name_is_read_as_a_string(akd):
    assert akd["name"] == "AKD-P00606-NBCC-E000"
    assert akd["identity"] == [0x6A, 0x414B44, 2]
    assert akd["types"] == [4, 1, 2, 3, 4]


def test_25_complete_access_where_the_model_has_it_else_its_abort_code(akd):
    assert akd["complete"] == [SDO_ERROR, 0x06010000]
    generic = on_the_wire("pysoem_services", "sdo", *GENERIC)
    assert generic["assignment"] == "01000016"
    assert generic["written"] == ["accepted", 0]
    assert generic["then"] == "020000160116"


NAME = "".join(chr(ord("a") + n % 26) for n in range(2000))


def test_23_an_object_of_2_kb_comes_in_segments_of_a_64_byte_mailbox(tmp_path):
    folder = tmp_path / "long_name"
    shutil.copytree(load("generic").folder, folder)
    for name, old, new in (
        ("objects.csv", "servogym generic CiA 402 drive", NAME),
        ("ethercat.toml", "[0x1000, 256, 0x1400, 256]", "[0x1000, 64, 0x1400, 64]"),
    ):
        text = (folder / name).read_text(encoding="utf-8")
        assert old in text
        (folder / name).write_text(text.replace(old, new), encoding="utf-8")
    result = on_the_wire("pysoem_services", "sdo", "--drive", str(folder), "--axis", "none")
    assert result["name"] == NAME


def test_27_the_dictionary_online_is_that_of_the_model():
    model = load("generic", "ethercat")
    offline = [
        [index, object_name(rows), rows[-1].subindex, rows]
        for index, rows in members(model).items()
    ]

    def in_time(online):  # SOEM leaves an entry empty whose answer comes late, or gives up
        return len(online) == len(offline) and all(
            each[2][row.subindex][0]
            for each, (*_, rows) in zip(online, offline, strict=True)
            for row in rows
        )

    online = on_the_wire("pysoem_services", "dictionary", *GENERIC, in_time=in_time)
    assert [row[0] for row in online] == [row[0] for row in offline]
    for (index, name, entries), (_, wanted, last, rows) in zip(online, offline, strict=True):
        assert name == wanted
        assert len(entries) == last + 1, f"{index:04X}h"
        for row in rows:
            entry = entries[row.subindex]
            assert entry[1:] == [DATA_TYPES[row.data_type], bits(row), access(row)], row.name
            assert entry[0] == row.name[: len(entry[0])]
            assert len(entry[0]) >= min(len(row.name), 40)


def test_27_the_akd_offers_no_dictionary():
    assert isinstance(on_the_wire("pysoem_services", "dictionary", *AKD), str)


def test_foe_reads_and_writes_the_parameter_file():
    content = json.loads(on_the_wire("pysoem_services", "files", *AKD))
    assert content["model"] == "kollmorgen_akd"


def test_13_the_eeprom_is_read_and_written():
    result = on_the_wire("pysoem_services", "eeprom", *AKD)
    assert [int.from_bytes(bytes.fromhex(word)[:4], "little") for word in result["identity"]] == [
        0x6A, 0x414B44, 2
    ]
    assert (result["before"], result["after"]) == ("0000", "4200")


def test_29_lost_replies_are_recovered_by_the_retry_of_soem():
    """A lost mailbox is asked for again by the repeat request.

    Only a request whose confirmation is lost fails: SOEM does not write it again. Its answer comes
    unasked then, and the next request works nevertheless.
    """
    result = on_the_wire(
        "pysoem_services", "lossy", "forked", line="lose at=mailbox:1 rate=0.05 count=0",
        in_time=lambda result: set(result["failed"]) <= {"WkcError -1"},  # 0: a late answer
    )
    assert len(result["failed"]) < 6
    assert set(result["failed"]) <= {"WkcError -1"}
    assert result["read"] == ["AKD-P00606-NBCC-E000"] * (60 - len(result["failed"]))
    assert [name for name, _ in result["written"]].count("accepted") > 15
    assert result["last"] == 19
