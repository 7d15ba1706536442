"""What is observed of a drive, and what a comparison with a model finds: planted differences."""

import contextlib
import csv
import json
import re
import threading

import can
import pytest

from servogym.drive.canopen.node import Node
from servogym.drive.canopen.observe import Observer, of_model
from servogym.drive.canopen.port import NodePort
from servogym.drive.drive import Drive
from servogym.drive.machine import Standing
from servogym.drive.model.model import load, model_names
from servogym.drive.observation import compare, opened, sealed
from servogym.drive.wire.server import Server
from servogym.envs.plants.catalogue import axis_for
from servogym.training.cli import main

MODELS = [name for name in model_names() if "can" in load(name).buses]
HEADER = (load("generic").folder / "objects.csv").read_text(encoding="utf-8").split("\n")[0]

# planted in a drive, and where it shows; each stands in a file of its folder
PLANTS = {
    "vendor": ("0x1018,0x01,,,,,,,,,0x1A3,,,,,,", {"1018h:01h"}),
    "product": ("0x1018,0x02,,,,,,,,,7,,,,,,", {"1018h:02h"}),
    "revision": ("0x1018,0x03,,,,,,,,,8,,,,,,", {"1018h:03h"}),
    "name": ("0x1008,0x00,,,,,,,,,somebody's drive,,,,,,", {"1008h:00h"}),
    "device type": (
        "0x1000,0x00,,,,,,,,,0x00060192,,,,,,",
        {"1000h:00h", "1000h:00h sub-index FEh"},
    ),
    "motor type": ("0x6402,0x00,,,,,,,,,3,,,,,,", {"6402h:00h"}),
    "following error window": ("0x6065,0x00,,,,,,,,,5000,,,,,,", {"6065h:00h"}),
    "position window": ("0x6067,0x00,,,,,,,,,77,,,,,,", {"6067h:00h"}),
    "chopper": ("0x2018,0x01,,,,,,,,,380000,,,,,,", {"2018h:01h"}),
    "an object more": ("0x5000,0x00,extra,VAR,UNSIGNED16,ro,,,,,5,,,,,,", {"5000h:00h"}),
    "a string more": ("0x4F00,0x00,text,VAR,VISIBLE_STRING,const,,,,,abc,,,,,,", {"4F00h:00h"}),
    "a sub-index more": ("0x2015,0x04,brake_more,RECORD,UNSIGNED8,rw,,,,,1,,,,,,", {"2015h:04h"}),
    "quick stop range": ("0x605A,0x00,,,,,,,,6,,,,,,,", {"605Ah:00h"}),
    "halt range": ("0x605D,0x00,,,,,,,,2,,,,,,,", {"605Dh:00h"}),
    "velocity range": ("0x6081,0x00,,,,,,,,90000000,,,,,,,", {"6081h:00h"}),
    "acceleration range": ("0x6083,0x00,,,,,,,10,,,,,,,,", {"6083h:00h"}),
    "limit range": ("0x607F,0x00,,,,,,,,2000000000,,,,,,,", {"607Fh:00h"}),
    "time-out range": ("0x6066,0x00,,,,,,,,1000,,,,,,,", {"6066h:00h"}),
    "window time range": ("0x606E,0x00,,,,,,,1,,,,,,,,", {"606Eh:00h"}),
    "quick stop access": ("0x6085,0x00,,,,ro,,,,,,,,,,,", {"6085h:00h"}),
    "homing access": ("0x609A,0x00,,,,ro,,,,,,,,,,,", {"609Ah:00h"}),
    "option access": ("0x605C,0x00,,,,ro,,,,,,,,,,,", {"605Ch:00h"}),
}
WITHOUT = {"60F2h": {"60F2h:00h"}, "6404h": {"6404h:00h"}, "60D8h": {"60D8h:00h"}}


def planted(tmp_path):
    """A folder with all of it -> the folder, and by plant where it shows."""
    folder = tmp_path / "real"
    folder.mkdir()
    shows = {name: where for name, (_, where) in PLANTS.items()}
    (folder / "objects.csv").write_text(
        "\n".join([HEADER, *(row for row, _ in PLANTS.values())]) + "\n", encoding="utf-8"
    )
    rows = [*csv.reader((load("generic").folder / "pdo.csv").read_text("utf-8").splitlines())]
    column = {name: n for n, name in enumerate(rows[0])}
    for row in rows[1:]:
        number = row[column["number"]]
        if row[0] == "rx" and number == "2":
            row[column["cob_id"]] = "0x310+node_id"
        if row[0] == "tx" and number == "1":
            row[column["transmission_type"]] = "1"
    with (folder / "pdo.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
    modes = ["pp", "vl", "pv", "hm", "ip", "csp", "csv", "cst"]
    methods = [m for m in load("generic").homing_methods if m != 33]
    without = json.dumps([*WITHOUT])
    (folder / "drive.toml").write_text(
        f'based_on = "generic"\nwithout = {without}\n[capabilities]\nmodes = {json.dumps(modes)}\n'
        f"homing_methods = {json.dumps(methods)}\n"
        '[abort_codes]\n"06070012h" = { value = 0x06070010, source = "planted" }\n'
        '[quirks]\nremote_bit = { value = 1, source = "planted" }\n',
        encoding="utf-8",
    )
    for name, where in WITHOUT.items():
        shows[f"without {name}"] = where
    shows["identifier of an RPDO"] = {"1401h:01h"}
    shows["type of a TPDO"] = {"1800h:02h"}
    shows["mode tq"] = {"mode 4", "6502h:00h"}
    shows["homing method 33"] = {"6098h:00h"} | {f"60E3h:{n:02X}h" for n in range(40)}
    words = ("0000h", "0006h", "0006h 0000h", "0080h", "0006h 0080h", "0006h 0006h", "0000h 0006h")
    shows["remote bit"] = {"6041h:00h"} | {f"controlword {word}" for word in words}
    lengths = ("5 bytes", "6 bytes", "8 bytes")
    codes = {
        f"{i:04X}h:{s:02X}h {n}" for i in range(0x1000, 0x6600) for s in range(3) for n in lengths
    }
    shows["abort code"] = codes
    return folder, shows


def test_planted_differences_are_found_and_none_is_invented(tmp_path):
    folder, shows = planted(tmp_path)
    assert len(shows) >= 30
    differences = compare(of_model(folder), of_model("generic"))
    where = {difference.where for difference in differences}
    missed = [name for name, places in shows.items() if not where & places]
    assert len(missed) <= len(shows) - 29, missed
    assert missed == []
    assert where <= set().union(*shows.values()), "invented"


@pytest.mark.parametrize("name", MODELS)
def test_an_observed_model_gives_back_that_model(name):
    found = of_model(name, node_id=9)
    assert found["read_only"] == ""
    assert compare(found, of_model(name, node_id=9)) == []
    assert not any("not_restored" in one for one in found["objects"].values())
    assert len(found["dialogues"]) >= 60


def test_two_models_are_told_apart():
    assert len(compare(of_model("festo_cmmp_as"), of_model("generic"))) > 100


@pytest.fixture
def served():
    """A drive on a bus of python-can, moved by an axis."""
    bus = can.Bus(interface="virtual", channel="servogym-observe")
    server = Server(bus, [axis_for("generic", 5)])
    thread = threading.Thread(target=server.run)
    thread.start()
    yield server.nodes[0].drive
    server.stop()
    thread.join(10)
    bus.shutdown()


COMMAND = ["observe", "--node-id", "5", "-i", "virtual", "-c", "servogym-observe"]


@pytest.mark.slow
def test_a_served_drive_is_observed_and_left_as_it_was(served, tmp_path, capsys):
    before = {(i, s): served.objects.read(i, s) for i, s in served.objects.slots}
    out = tmp_path / "drive.json"
    assert main([*COMMAND, "-o", str(out)]) == 0
    assert "is put back" in capsys.readouterr().out
    after = {(i, s): served.objects.read(i, s) for i, s in served.objects.slots}
    live = (0x6041, 0x6063, 0x6064, 0x6040, 0x6061)
    changed = [a for a in before if before[a] != after[a] and a[0] not in live]
    assert changed == []
    assert main(["observe", "--compare", str(out), "--drive", "generic"]) == 1
    told = capsys.readouterr().out
    assert "6091h" not in told
    assert "6081h:00h: value" in told  # commissioned for its axis


def test_nothing_is_written_to_a_drive_that_is_enabled():
    drive = Drive("generic", node_id=3)
    bench = Standing({"x": drive}, drive.model.cycle_time["position"])
    port = NodePort(bench, Node(drive))
    for word in (0x06, 0x07, 0x0F):
        drive.write("controlword", word)
        bench.step(200)
    before = {(i, s): drive.objects.read(i, s) for i, s in drive.objects.slots}
    found = Observer(port, 3).observe()
    assert found["read_only"] == "node 3 is in OPERATION_ENABLED"
    assert not any("write" in one for one in found["objects"].values())
    assert not any(name.startswith(("controlword", "mode")) for name in found["dialogues"])
    after = {(i, s): drive.objects.read(i, s) for i, s in drive.objects.slots}
    assert before == after


@pytest.mark.parametrize("words", [(), (0x06, 0x07, 0x0F)], ids=["off", "enabled"])
@pytest.mark.parametrize("read_only", [False, True])
def test_a_drive_that_guards_its_master_keeps_its_state(words, read_only):
    drive = Drive("generic", node_id=3)
    bench = Standing({"x": drive}, drive.model.cycle_time["position"])
    port = NodePort(bench, Node(drive))
    drive.write("guard_time", 100)  # ms
    drive.write("life_time_factor", 4)
    for word in (0, *words):
        drive.write("controlword", word)
        bench.step(200)
    state = drive.state
    found = Observer(port, 3, read_only=read_only).observe()
    for _ in range(200):  # 2 s
        port.exchange([])
        bench.step(round(0.01 / bench.cycle_time))
    assert (drive.state, drive.read("error_code")) == (state, 0)
    assert "from then on" in found["dialogues"]["node guarding"][0]


def test_ranges_are_compared_in_the_type_in_which_the_drive_was_asked(tmp_path):
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "drive.toml").write_text('based_on = "generic"\n')
    row = "0x60E1,0x00,negative_torque_limit,VAR,INTEGER16,rw,rx,,,,-1000,yes,,,"
    (folder / "objects.csv").write_text(f"{HEADER}\n{row}negative_torque_limit,,\n")
    drive = Drive(folder, node_id=3)
    port = NodePort(Standing({"x": drive}, drive.model.cycle_time["position"]), Node(drive))
    found = Observer(port, 3).observe()  # a stranger's: nobody knows that it is signed
    assert found["objects"]["60E1h:00h"]["high"] == 65535
    assert compare(found, of_model(folder, 3, found)) == []


def test_nothing_is_written_while_another_drive_on_the_bus_is_enabled():
    drives = [Drive("generic", node_id=n) for n in (3, 4)]
    bench = Standing({str(d.node_id): d for d in drives}, drives[0].model.cycle_time["position"])
    nodes = [Node(drive) for drive in drives]
    drives[1].write(0x1017, 0, 50)  # its heartbeat is heard
    for word in (0x06, 0x07, 0x0F):
        drives[1].write("controlword", word)
        bench.step(200)
    assert Observer(NodePort(bench, *nodes), 3).observe()["read_only"].startswith("node 4 is in")


def test_an_observation_that_was_altered_is_refused(tmp_path, capsys):
    found = sealed({"format": "servogym observation", "version": 1, "bus": "can", "node_id": 1,
                    "read_only": "", "objects": {}, "dialogues": {}})
    assert opened(json.dumps(found), "x") == found
    for spoilt in (json.dumps(found | {"node_id": 2}), "[]", "{}", "hello", json.dumps({})):
        with pytest.raises(ValueError, match=r"x (was altered|is no)"):
            opened(spoilt, "x")
        file = tmp_path / "x.json"
        file.write_text(spoilt)
        assert main(["observe", "--compare", str(file), "--drive", "generic"]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_a_comparison_proposes_a_model_that_says_the_same(tmp_path, capsys):
    folder, _ = planted(tmp_path)
    file, out = tmp_path / "real.json", tmp_path / "mine"
    file.write_text(json.dumps(of_model(folder)))
    assert main(["observe", "--compare", str(file), "--drive", "generic", "-o", str(out)]) == 1
    assert "marked observed" in capsys.readouterr().out
    rest = compare(of_model(folder), of_model(out))
    before = compare(of_model(folder), of_model("generic"))
    assert len({d.where for d in rest if "h:" in d.where[:6]}) < len(before) / 2
    assert Drive(out).read("following_error_window") == 5000
    assert load(out).objects[0x6065, 0].section == "observed"
    assert "`observed`" in (out / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_slave_of_another_stack_is_observed():
    """`canopen.LocalNode`: it keeps what is written and knows no states."""
    import canopen

    from servogym.drive.canopen.eds import object_dictionary
    from servogym.drive.wire.bus import CanPort

    network = canopen.Network()
    network.connect(interface="virtual", channel="servogym-observe-foreign")
    network.add_node(canopen.LocalNode(5, object_dictionary("generic", 5)))
    bus = can.Bus(interface="virtual", channel="servogym-observe-foreign")
    try:
        found = Observer(CanPort(bus, wait=0.001), 5).observe()
    finally:
        bus.shutdown()
        network.disconnect()
    assert found["read_only"] == ""
    assert found["objects"]["1018h:02h"]["value"] == "02040000"
    assert not any("not_restored" in one for one in found["objects"].values())
    differences = compare(found, of_model("generic", node_id=5))
    assert any(d.where.startswith("controlword 0006h") for d in differences), "it has no states"
    assert any(d.where == "605Ah:00h" and d.what == "values" for d in differences), "nor ranges"
    identity = {f"1018h:{n:02X}h" for n in range(5)}
    assert not identity & {d.where for d in differences}


@pytest.mark.slow
def test_what_is_planted_in_a_foreign_node_is_found_by_the_commands(tmp_path, capsys):
    """`canopen.LocalNode` of an EDS with changes, against the model made from the EDS, over UDP."""
    import canopen

    sheet, mine, out = tmp_path / "drive.eds", tmp_path / "mine", tmp_path / "drive.json"
    assert main(["eds", "generic", "-o", str(sheet)]) == 0
    assert main(["drives", "--from-eds", str(sheet), "-o", str(mine)]) == 0
    node = canopen.LocalNode(5, str(sheet))
    del node.object_dictionary[0x6083]  # an object that it does not have
    node.object_dictionary[0x6065].data_type = canopen.objectdictionary.UNSIGNED16
    changed = {(0x6081, 0): b"\x39\x30\0\0", (0x1018, 3): b"\7\0\0\0", (0x6065, 0): b"\x39\x30",
               (0x607D, 2): b"\x11\x11\0\0", (0x605A, 0): b"\5\0"}
    for (index, subindex), data in changed.items():
        node.data_store.setdefault(index, {})[subindex] = data
    network = canopen.Network()
    network.connect(interface="udp_multicast", channel="239.74.163.32", port=43132)
    network.add_node(node)
    there = ["-i", "udp_multicast", "-c", "239.74.163.32", "--bus-kwargs", "port=43132"]
    asked, again = canopen.Network(), {}
    try:
        assert main(["observe", "--node-id", "5", "-o", str(out), *there]) == 0
        found = json.loads(out.read_text())["objects"]
        asked.connect(interface="udp_multicast", channel="239.74.163.32", port=43132)
        client = asked.add_node(canopen.RemoteNode(5, str(sheet))).sdo
        for where in (f"{index:04X}h:{sub:02X}h" for index, sub in load(mine).objects):
            with contextlib.suppress(canopen.SdoAbortedError):
                again[where] = client.upload(int(where[:4], 16), int(where[6:8], 16)).hex()
    finally:
        asked.disconnect()
        network.disconnect()
    assert json.loads(out.read_text())["sha256"]
    assert len(again) > 200
    said = {where: found[where]["value"] for where in again}
    assert said == again, "a foreign client reads the same, and all there is"
    for (index, subindex), data in changed.items():
        assert node.data_store[index][subindex] == data, "what was written is put back"
    capsys.readouterr()
    assert main(["observe", "--compare", str(out), "--drive", str(mine)]) == 1
    told = capsys.readouterr().out
    for index, subindex in (*changed, (0x6083, 0)):
        assert f"{index:04X}h:{subindex:02X}h" in told
    # no value is invented: the others that differ are those that each stack has of its own
    differ = {line[:9] for line in told.splitlines() if re.match(r"[0-9A-F]{4}h:..h: value:", line)}
    assert {where for where in differ if int(where[:4], 16) >= 0x2000} <= {
        f"{index:04X}h:{subindex:02X}h" for index, subindex in changed}
