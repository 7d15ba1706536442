"""The data sheet says what the model says, row for row, as the `canopen` library reads it back."""

import configparser
import dataclasses
import shutil
import struct
import subprocess
import sys

import canopen
import pytest
from canopen.objectdictionary import ODArray, ODRecord, ODVariable, datatypes

from servogym.drive.canopen import eds
from servogym.drive.drive import Drive
from servogym.drive.model.model import load, model_names
from servogym.training import cli

NODE_ID = 5


def variable(od, row):
    entry = od[row.index]
    return entry if isinstance(entry, ODVariable) else entry.subindices[row.subindex]


def addresses(od):
    for entry in od.values():
        if isinstance(entry, ODVariable):
            yield entry.index, 0
        else:
            yield from ((entry.index, subindex) for subindex in entry.subindices)


def written(path, model, node_id=None, reader_id=NODE_ID):
    eds.write(model, path, node_id)
    return canopen.import_od(str(path), reader_id)


def sections(path):
    file = configparser.RawConfigParser()
    file.optionxform = str
    file.read(path, encoding="ascii")
    return file


@pytest.mark.parametrize("model", model_names())
@pytest.mark.parametrize("suffix", [".eds", ".dcf"])
def test_every_row_comes_back(tmp_path, model, suffix):
    od = written(tmp_path / f"drive{suffix}", model, NODE_ID if suffix == ".dcf" else None)
    rows = eds.rows(load(model))
    assert {*addresses(od)} == {(r.index, r.subindex) for r in rows} | {(i, 0) for i in range(2, 8)}
    for row in rows:
        read = variable(od, row)
        assert read.name == row.name
        assert read.data_type == getattr(datatypes, row.data_type), row
        directions = {("rw", "rx"): "rww", ("rw", "tx"): "rwr"}
        assert read.access_type == directions.get((row.access, row.pdo), row.access), row
        assert read.pdo_mappable == bool(row.pdo), row
        expected = row.default + NODE_ID if row.per_node else row.default
        if read.default is None:  # what the drive measures, or has to be asked for
            assert row.access == "ro" or row.data_type == "DOMAIN", row
        else:
            assert read.default == expected or row.data_type == "DOMAIN", row
        assert read.relative == row.per_node, row
        if row.format not in ("", "f", "q", "Q"):
            assert (read.min, read.max) == (row.minimum, row.maximum), row
        if row.subindex:
            assert isinstance(od[row.index], ODArray | ODRecord), row


@pytest.mark.parametrize("model", model_names())
def test_default_and_parameter_value_are_what_the_drive_has_after_power_on(tmp_path, model):
    od = written(tmp_path / "drive.dcf", model, NODE_ID, reader_id=None)
    drive = Drive(model, node_id=NODE_ID)
    assert od.node_id == NODE_ID
    described = {(row.index, row.subindex) for row in eds.rows(load(model))}
    for (index, subindex), slot in drive.objects.slots.items():
        if (index, subindex) not in described:
            continue
        read = variable(od, slot.row)
        assert (read.default or 0) == (read.value or 0), f"{index:04X}h:{subindex:02X}h"
        if slot.row.access == "rw" and slot.row.data_type != "DOMAIN":
            # the float of a REAL32 is the nearest of 32 bits
            now = slot.get()
            value = struct.unpack("f", struct.pack("f", read.value))[0] if slot.row.format == "f" \
                else read.value
            assert value == now, f"{index:04X}h:{subindex:02X}h"


@pytest.mark.parametrize("model", model_names())
def test_only_a_sub_index_0_that_is_no_number_of_entries_is_left_out(model):
    model = load(model)
    described = {(row.index, row.subindex) for row in eds.rows(model)}
    missing = {address for address in Drive(model).objects.slots if address not in described}
    assert {subindex for _, subindex in missing} <= {0, 5}
    counts = [sum(sub == left for _, sub in missing) for left in (0, 5)]
    assert counts == ([16, 8] if model.name == "bonfiglioli_act" else [0, 0])


def test_without_a_file_data_set_0_is_described_with_its_type():
    model = load("bonfiglioli_act")
    od = eds.object_dictionary(model)
    sets = [row for row in model.objects.values() if (row.subindex, row.hook) == (0, "data_set")]
    assert len(sets) == 16
    for row in sets:
        described = od[row.index][0]
        assert described.data_type == getattr(eds.datatypes, row.data_type), row.name
        assert (described.min, described.max) == (row.minimum, row.maximum)


@pytest.mark.parametrize("model", model_names())
def test_live_values_have_no_default(model):
    od = eds.object_dictionary(model)
    for index in (0x1001, 0x6041, 0x6064, 0x606C, 0x6077):
        if index in od.indices:
            assert od[index].default is None, f"{index:04X}h"
    assert od[0x1018][1].default is not None


@pytest.mark.parametrize("model", model_names())
def test_the_names_lead_to_their_objects(model):
    od = eds.object_dictionary(model)
    assert len(od.names) == len(od.indices)
    for name, entry in od.names.items():
        assert od[name] is entry


def test_identifiers_count_from_the_node_id_in_the_file(tmp_path):
    path = tmp_path / "drive.eds"
    eds.write("generic", path)
    assert sections(path)["1800sub1"]["DefaultValue"] == "$NODEID+0x40000180"
    for node_id in (1, 127):
        od = canopen.import_od(str(path), node_id)
        assert od[0x1800][1].default == 0x40000180 + node_id
        assert od[0x1014].default == 0x80 + node_id


def test_the_device_information_is_complete(tmp_path):
    path = tmp_path / "drive.eds"
    od = written(path, "generic")
    info = od.device_information
    model = load("generic")
    assert info.vendor_number == model.objects[0x1018, 1].default
    assert info.product_number == model.objects[0x1018, 2].default
    assert info.revision_number == model.objects[0x1018, 3].default
    assert (info.nr_of_RXPDO, info.nr_of_TXPDO) == (len(model.rpdos), len(model.tpdos))
    assert info.allowed_baudrates == {*eds.BITRATES}
    assert info.simple_boot_up_slave
    assert not info.simple_boot_up_master
    device = sections(path)["DeviceInfo"]
    assert device["Granularity"] == "8"  # the library reads a truth value
    for key in ("DynamicChannelsSupported", "GroupMessaging", "CompactPDO", "LSS_Supported"):
        assert device[key] in "01"


def test_the_supported_objects_are_listed_once_each(tmp_path):
    path = tmp_path / "drive.eds"
    eds.write("generic", path)
    file = sections(path)
    listed = []
    for name in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        entries = [int(v, 16) for k, v in file[name].items() if k != "SupportedObjects"]
        assert int(file[name]["SupportedObjects"]) == len(entries)
        listed += entries
    assert sorted(listed) == sorted({row.index for row in eds.rows(load("generic"))})


def test_each_file_has_its_own_name_in_it(tmp_path):
    for name in ("first", "second"):  # the library keeps the file information of the first one
        eds.write("generic", tmp_path / f"{name}.eds")
        info = sections(tmp_path / f"{name}.eds")["FileInfo"]
        assert tuple(info) == eds.FILE_INFO
        assert info["FileName"] == f"{name}.eds"


def test_a_dcf_names_its_node(tmp_path):
    path = tmp_path / "drive.dcf"
    eds.write("generic", path, 7)
    commissioning = sections(path)["DeviceComissioning"]  # sic, CiA 306
    assert commissioning["NodeID"] == "7"
    assert commissioning["Baudrate"] == "1000"
    assert sections(path)["1400sub1"]["ParameterValue"] == "0x00000207"


def own_model(tmp_path, old, new):
    folder = tmp_path / "my_drive"
    shutil.copytree(load("generic").folder, folder)
    objects = folder / "objects.csv"
    text = objects.read_text(encoding="utf-8")
    assert old in text
    objects.write_text(text.replace(old, new, 1), encoding="utf-8")
    return folder


def test_a_folder_of_one_s_own_with_64_bits_and_floats(tmp_path):
    line = "0x2019,"
    more = (
        "0x2100,0x00,big,VAR,INTEGER64,rw,,µm/s²,,,-9000000000000000000,,own,,,,\n"
        "0x2101,0x00,bigger,VAR,UNSIGNED64,rw,,,,,18000000000000000000,,own,,,,\n"
        "0x2102,0x00,broken,VAR,REAL32,rw,,,,,-0.1,,own,,,,\n"
    )
    folder = own_model(tmp_path, line, more + line)
    od = written(tmp_path / "drive.eds", folder)
    assert od["big"].default == -9 * 10**18
    assert (od["big"].min, od["big"].max) == (-(2**63), 2**63 - 1)
    assert od["bigger"].default == 18 * 10**18
    assert (od["bigger"].min, od["bigger"].max) == (0, 2**64 - 1)
    assert od["broken"].default == -0.1


@pytest.mark.parametrize("text", ["drive ; of mine", "Antrieb für alles"])
def test_a_text_the_file_cannot_carry_is_refused(tmp_path, text):
    folder = own_model(tmp_path, "servogym generic CiA 402 drive", text)
    with pytest.raises(ValueError, match=r"1008h:00h: .* cannot stand in an EDS"):
        eds.write(folder, tmp_path / "drive.eds")


def test_pdos_that_the_model_lists_are_its_only_ones_and_mixed_types_make_a_record(tmp_path):
    line = "0x2019,"
    more = (
        "0x1400,0x00,receive_pdo_parameter,RECORD,UNSIGNED8,ro,,,,,2,,own,,,,\n"
        "0x1400,0x01,receive_pdo_cob_id,VAR,UNSIGNED32,rw,,,,,0x200,,own,,,,\n"
        "0x2100,0x00,mixed,RECORD,UNSIGNED8,ro,,,,,1,,own,,,,\n"
        "0x2100,0x01,statusword_2,VAR,INTEGER8,rw,,,,,-1,,own,,,,\n"
        "0x2101,0x00,mixed_entries,RECORD,UNSIGNED8,ro,,,,,1,,own,,,,\n"
        "0x2101,0x01,more,RECORD,INTEGER8,rw,,,,,-1,,own,,,,\n"
        "0x2102,0x00,lonely,ARRAY,UNSIGNED8,const,,,,,0,,own,,,,\n"
    )
    folder = own_model(tmp_path, line, more + line)
    od = written(tmp_path / "drive.eds", folder)
    addressed = [*addresses(od)]
    assert len(addressed) == len({*addressed})
    assert {*addressed} == {*Drive(folder).objects.slots} | {(i, 0) for i in range(2, 8)}
    assert od[0x1400][1].name == "receive_pdo_cob_id"
    assert isinstance(od["mixed"], ODRecord)
    assert od["mixed_2101h"][1].default == -1
    assert isinstance(od["lonely"], ODArray)


def test_arrays_records_and_variables_come_back_as_such(tmp_path):
    od = written(tmp_path / "drive.eds", "generic")
    kinds = {"VAR": ODVariable, "ARRAY": ODArray, "RECORD": ODRecord}
    for row in eds.rows(load("generic")):
        assert type(od[row.index]) is kinds[row.object_type], row


def test_a_row_that_differs_is_found_by_the_comparison(tmp_path):
    row = load("generic").objects[0x607D, 1]
    changed = dataclasses.replace(row, default=row.default + 1)
    od = written(tmp_path / "drive.eds", "generic")
    assert variable(od, changed).default != changed.default


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nothing", "-o", "x.eds"], "unknown drive model 'nothing': choose one of"),
        (["generic", "-o", "x.txt"], "the name of the file has to end with .eds"),
        (["generic", "-o", "x.eds", "--dcf", "--node-id", "1"], "has to end with .dcf"),
        (["generic", "-o", "x.dcf", "--dcf"], "--dcf and --node-id belong together"),
        (["generic", "-o", "x.eds", "--node-id", "1"], "--dcf and --node-id belong together"),
        (["generic", "-o", "x.dcf", "--dcf", "--node-id", "128"], "128 is out of range 1..127"),
        (["generic", "-o", "nowhere/x.eds"], "nowhere/x.eds"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(refused, tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(tmp_path)
    assert says in refused(["eds", *arguments])
    assert not [*tmp_path.iterdir()]


def test_the_command_writes_the_file(capsys, tmp_path):
    path = tmp_path / "drive.dcf"
    assert cli.main(["eds", "generic", "-o", str(path), "--dcf", "--node-id", "9"]) == 0
    assert path.is_file()
    assert "objects of generic" in capsys.readouterr().out


CAN_MODELS = [name for name in model_names() if "can" in load(name).buses]


@pytest.fixture
def dcfchk(monkeypatch):
    """A command of dcf-tools, which the master of ROS 2 is configured with; its warnings raise."""
    command = pytest.importorskip("dcf.cli").main

    def check(*arguments):
        monkeypatch.setattr(sys, "argv", ["dcfchk", *map(str, arguments)])
        command()

    return check


@pytest.mark.parametrize("suffix", [".eds", ".dcf"])
@pytest.mark.parametrize("model", CAN_MODELS)
def test_dcfchk_accepts_the_file(tmp_path, model, suffix, dcfchk):
    path = tmp_path / f"drive{suffix}"
    eds.write(model, path, NODE_ID if suffix == ".dcf" else None)
    dcfchk("-n", NODE_ID, path)


def test_dcfchk_is_able_to_refuse(tmp_path, dcfchk):
    path = tmp_path / "drive.eds"
    eds.write("generic", path)
    text = path.read_text(encoding="ascii")
    path.write_text(text.replace("[6041]", "[6041]\nUnit=rad", 1), encoding="ascii")
    with pytest.raises(UserWarning, match=r"invalid entry in \[6041\]: Unit"):
        dcfchk("-n", NODE_ID, path)


def concise(data):
    """Index, sub-index and bytes of the downloads of a concise DCF (CiA 302-3)."""
    (count,), at = struct.unpack_from("<I", data), 4
    for _ in range(count):
        index, subindex, size = struct.unpack_from("<HBI", data, at)
        at += 7
        yield index, subindex, data[at : at + size]
        at += size
    assert at == len(data)


@pytest.fixture(scope="module")
def bus(tmp_path_factory):
    """A folder with what dcfgen makes of a bus of all models; node ids and least downloads."""
    folder, slaves, nodes = tmp_path_factory.mktemp("bus"), "", {}
    for node_id, model in enumerate(CAN_MODELS, NODE_ID):
        eds.write(model, folder / f"{model}.eds")
        objects = load(model).objects
        heartbeat = "  heartbeat_producer: 100\n" if (0x1017, 0) in objects else ""
        sync = "  tpdo: {1: {enabled: true, cob_id: auto, transmission: 1}}\n"
        sync = sync if (0x6064, 0) in objects else ""
        slaves += (
            f"{model}:\n  dcf: {model}.eds\n  node_id: {node_id}\n{heartbeat}{sync}"
            "  sdo: [{index: 0x6040, sub_index: 0, value: 0}]\n"
        )
        nodes[model] = node_id, 1 + bool(heartbeat) + 2 * bool(sync)
    (folder / "bus.yml").write_text(f"master:\n  node_id: 127\n{slaves}")
    result = subprocess.run(
        [sys.executable, "-c", "from dcfgen.cli import main; main()", "-v", "bus.yml"],
        capture_output=True, text=True, timeout=60, cwd=folder,
    )
    assert result.returncode == 0, result.stderr
    assert (folder / "master.dcf").is_file()
    return folder, nodes


@pytest.mark.parametrize("model", CAN_MODELS)
def test_the_drive_accepts_each_download_of_the_concise_dcf_that_dcfgen_makes(bus, model):
    folder, nodes = bus
    node_id, least = nodes[model]
    drive = Drive(model, node_id=node_id)
    downloads = [*concise((folder / f"{model}.bin").read_bytes())]
    assert len(downloads) >= least
    for index, subindex, data in downloads:
        assert drive.objects.write(index, subindex, data) == 0, f"{index:04X}h:{subindex:02X}h"
