"""Parameter files of users: what is in them is checked before the drive starts with it."""

import json
import os
import random
import subprocess
import sys
import time
import warnings

import pytest

from servogym.drive.canopen.frame import parse
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive
from servogym.drive.model import files
from servogym.drive.model.model import model_names
from servogym.drive.objects import store
from servogym.envs.plants.linear_axis import linear_axis
from servogym.envs.serve.description import BusRow, Description, nodes
from servogym.envs.serve.laboratory import Laboratory

SAVE, LOAD = 0x65766173, 0x64616F6C
ODD = (0, 1, -1, 2.5, 1e300, True, 10**30, -(10**30))


@pytest.fixture
def file(tmp_path):
    return tmp_path / "parameters.json"


def written(file, model="generic", **values):
    """A file with a good checksum and any values, by name of the object or address."""
    drive = Drive(model)
    stored = drive.parameters.values()
    ranges = drive.parameters._ranges(stored)
    for name, value in values.items():
        row = drive.model.names.get(name)
        stored[f"{row.index:04X}:{row.subindex:02X}" if row else name] = value
    file.write_text(store.encode(drive.model.name, stored, ranges))


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"quick_stop_option_code": 99}, r"605A:00 = 99 is out of range 0..8"),
        ({"quick_stop_option_code": 2.5}, "605A:00 = 2.5 is not of type INTEGER16"),
        ({"quick_stop_option_code": True}, "605A:00 = True is not a number"),
        ({"homing_method": 99}, "6098:00 = 99"),
        ({"feed": 0}, "6092:01 = 0 is out of range"),
        ({"1600:00": 200}, "1600:00 = 200 is more than 16 entries"),
        ({"reaction:999": 1}, "reaction:999 = 1 is not a reaction to a fault"),
        ({"alias:0": -1}, "alias:0 = -1 cannot be stored"),
        ({"lss:0": 200}, "lss:0 = 200 cannot be stored"),
        ({"anything": 1}, "anything = 1 has no address of an object"),
    ],
)
def test_a_value_the_drive_cannot_have_is_named_and_the_file_ignored(file, values, says):
    written(file, profile_velocity=4711, **values)
    with pytest.warns(UserWarning, match=rf"parameters.json is ignored.*{says}.*1010h"):
        drive = Drive(parameter_file=file)
    assert drive.read("profile_velocity") == drive.model.names["profile_velocity"].default


def test_values_that_do_not_go_together_are_named_and_the_file_ignored(file):
    values = {"feed": 2_147_483_629, "encoder_increments": 2_147_483_587}
    drive = Drive()
    drive.write("feed", values["feed"])
    written(file, profile_velocity=4711, gear_motor_revolutions=2_147_483_563, **{
        name: value for name, value in values.items() if name in drive.model.names
    })
    with pytest.warns(UserWarning, match=r"is ignored.*general internal incompatibility"):
        drive = Drive(parameter_file=file)
    assert drive.read("profile_velocity") == drive.model.names["profile_velocity"].default


def test_the_range_at_the_time_of_storing_is_told(file):
    written(file)
    text = json.loads(file.read_text())
    del text["crc32"]
    text["values"]["605A:00"], text["ranges"]["605A:00"] = 99, [0, 200]
    file.write_text(json.dumps(text | {"crc32": store._checksum(text)}))
    with pytest.warns(UserWarning, match=r"605A:00 = 99 .*0\.\.200 when it was stored"):
        Drive(parameter_file=file)


def test_a_file_of_an_older_form_is_named(file):
    file.write_text(json.dumps({"model": "generic", "values": {}, "crc32": 0}))
    with pytest.warns(UserWarning, match="it has the form None, not 2"):
        Drive(parameter_file=file)


def test_a_file_that_cannot_be_read_is_told(tmp_path):
    with pytest.warns(UserWarning, match="it cannot be read"):
        Drive(parameter_file=tmp_path)
    plain = tmp_path / "a file"
    plain.touch()
    with pytest.warns(UserWarning, match="it cannot be read"):
        Drive(parameter_file=plain / "parameters.json")


def test_a_file_larger_than_any_drives_is_not_read_to_its_end(file):
    with file.open("wb") as grown:
        grown.truncate(1 << 40)  # a hole of a tebibyte
    with pytest.warns(UserWarning, match=f"a parameter file has at most {files.LARGEST};"):
        Drive(parameter_file=file)


def test_what_killed_processes_left_is_removed_when_the_next_one_saves(file):
    old, fresh = (file.with_name(f"{file.name}{n}.tmp") for n in ("old", "fresh"))
    for left in (old, fresh):
        left.touch()
    os.utime(old, (0, time.time() - 2 * store.LEFT_OVER))
    Drive(parameter_file=file).write("save_all_parameters", SAVE)
    assert sorted(path.name for path in file.parent.iterdir()) == [file.name, fresh.name]


def damaged(text, chance):
    """Bytes lost, changed, doubled; or a value changed and the checksum made good again."""
    dice = chance.random()
    if dice < 0.4:
        content = json.loads(text)
        del content["crc32"]
        values = content["values"]
        for _ in range(chance.choice((1, 1, 2, 10))):
            address = chance.choice([*values])
            low, high = content["ranges"].get(address, [0, 1])
            near = (low, high, low - 1, high + 1, chance.randint(low, high), *ODD)
            values[address] = chance.choice(near)
        if dice < 0.02:
            content[chance.choice([*content])] = chance.choice([None, [], {}, "x", 1])
        return json.dumps(content | {"crc32": store._checksum(content)}).encode()
    data = bytearray(text.encode())
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(data) + 1)
        kind = chance.randrange(4)
        if kind == 0:
            del data[at : at + chance.choice((1, 10, 1000))]
        elif kind == 1:
            data[at:at] = chance.choice([b"[", b"\x00", b"\xff", b"9" * 30, b"[" * 5000, b'"'])
        elif kind == 2 and at < len(data):
            data[at] = chance.randrange(256)
        else:
            data = data[:at]
    return bytes(data)


def start_with_damaged_files(file, seed, count):
    chance = random.Random(seed)
    texts = {}
    for name in model_names():
        drive = Drive(name, parameter_file=file)
        drive.parameters.save()
        texts[name] = file.read_text()
        file.unlink()
    told = 0
    for _ in range(count):
        name = chance.choice([*texts])
        data = damaged(texts[name], chance)
        file.write_bytes(data)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            drive = Drive(name, parameter_file=file)
        told += bool(caught)
        assert all("is ignored" in str(warning.message) for warning in caught)
        assert all(str(warning.message).count("\n") == 0 for warning in caught)
        for _ in range(2):
            assert drive.cycle(0.0) == 0.0
        drive.exchange(bytes(drive.rpdo_size))
    return told


def test_damaged_parameter_files_are_told_and_never_a_traceback(file):
    assert start_with_damaged_files(file, 1, 100) > 50


@pytest.mark.slow
def test_2000_damaged_parameter_files_are_told_and_never_a_traceback(file):
    assert start_with_damaged_files(file, 2, 2000) > 1000


SAVER = """
import os, random, signal, sys, time
from servogym.drive.drive import Drive
drive = Drive("generic", parameter_file=sys.argv[1])
chance = random.Random(5)
for kill in range(int(sys.argv[2])):
    begins, begun = os.pipe()
    child = os.fork()
    if not child:
        n = 1000 * kill
        while True:
            n += 1
            drive.write("profile_velocity", n)
            drive.write("quick_stop_deceleration", n)
            drive.write("save_all_parameters", 0x65766173)
            os.write(begun, b".") if n % 1000 == 1 else None
    os.read(begins, 1)
    time.sleep(chance.uniform(0, 0.003))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.close(begins), os.close(begun)
    print(kill, flush=True)
    sys.stdin.readline()
"""


def kill_while_saving(file, kills, tell):
    """-> parameter sets that were found after a kill, and files left beside it at the worst."""
    found, left = set(), 0
    process = subprocess.Popen(
        [sys.executable, "-c", SAVER, str(file), str(kills)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with process:
        for kill in range(kills):
            assert process.stdout.readline() == b"%d\n" % kill
            found.add(whole(file))
            left = max(left, len(list(file.parent.iterdir())) - 1)
            process.stdin.write(b"\n")
            process.stdin.flush()
            if (kill + 1) % 100 == 0:
                tell(f"{kill + 1} kills, {len(found)} sets found, {left} left beside the file")
    assert process.returncode == 0
    return found, left


def whole(file):
    """The number that was saved last; the file is whole and its two values belong together."""
    if not file.exists():
        return 0
    values = store.decode(file.read_text(), "generic")
    assert values["6081:00"] == values["6085:00"]
    return values["6081:00"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_no_kill_during_1010h_tears_the_file(file, tell):
    assert len(kill_while_saving(file, 20, tell)[0]) > 3


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_of_a_thousand_kills_during_1010h_none_tears_the_file(file, tell):
    """And what they leave beside it is gone after the next save of a later time."""
    found, left = kill_while_saving(file, 1000, tell)
    assert len(found) > 100
    assert left > 0
    past = time.time() - 2 * store.LEFT_OVER
    for path in file.parent.iterdir():
        os.utime(path, (past, past))
    store.save(file, "generic", {})
    assert [path.name for path in file.parent.iterdir()] == [file.name]


# ---------------------------------------------------------------------- LSS, node, axis


def frames(node, *texts):
    for text in texts:
        node.receive(parse(text), 0)
    return [*map(str, node.poll(0))]


CONFIGURE = ("7E5#0401000000000000", "7E5#1105000000000000", "7E5#1300020000000000",
             "7E5#1700000000000000")


def test_what_lss_stores_is_there_after_power_on_and_survives_1011h(file):
    node = Node(Drive(parameter_file=file))
    node.drive.write("profile_velocity", 4711)
    assert frames(node, *CONFIGURE)[-1] == "7E4#1700000000000000"
    again = Node(Drive(parameter_file=file))
    assert (again.node_id, again.lss.stored_bit_rate) == (5, 500_000)
    assert again.drive.read("profile_velocity") != 4711, "LSS stores no parameters"
    again.drive.write("save_all_parameters", SAVE)
    again.drive.write("restore_all_default_parameters", LOAD)
    assert Node(Drive(parameter_file=file)).node_id == 5


def test_lss_tells_that_it_cannot_store(tmp_path):
    node = Node(Drive(parameter_file=tmp_path / "missing" / "p.json"))
    assert frames(node, *CONFIGURE)[-1] == "7E4#1702000000000000"


def test_without_a_file_lss_stores_in_the_drive_and_its_copies():
    node = Node(Drive())
    frames(node, *CONFIGURE)
    copy = Drive()
    copy.restore(node.drive.snapshot())
    assert Node(node.drive).node_id == Node(copy).node_id == 5


def test_a_linear_axis_takes_its_file_before_what_commissions_it(file):
    axis = linear_axis(parameter_file=file)
    drive = axis.drives["x"]
    assert drive.read("home_offset") == 5_000
    drive.write("home_offset", 4711)
    drive.write("save_all_parameters", SAVE)
    again = linear_axis(parameter_file=file).drives["x"]
    assert again.read("home_offset") == 4711
    assert again.read("feed") == drive.read("feed")


def test_each_of_several_drives_of_a_node_has_its_own_file(tmp_path):
    def machines(node_ids, axis):
        bus = BusRow("bus", "can", interface="virtual")
        rows = nodes("generic", node_ids, axis, f"{tmp_path / 'p.json'}")
        return Laboratory(Description((bus,), rows, by_options=True)).machines.values()

    for axis, drives, kept in (
        ("linear", 2, ["p_3.json", "p_4.json"]), ("conveyor", 2, ["p_3.json", "p_4.json"]),
        ("gantry", 3, ["p_3.json", "p_4.json", "p_5.json"]),
    ):
        for machine in machines([3] if drives == 3 else [3, 4], axis):
            for drive in machine.drives.values():
                drive.write("save_all_parameters", SAVE)
        assert sorted(path.name for path in tmp_path.iterdir()) == kept
        for path in tmp_path.iterdir():
            path.unlink()
    tmp_path.rmdir()
    with pytest.raises(ValueError, match=r"^--parameter-file = .* there is no folder .* make it"):
        machines([3], "linear")


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[: len(text) // 2],
        lambda text: text.replace('"generic"', '"another"'),
        lambda text: text.replace("6081:00", "6081:01"),
        lambda text: "",
        lambda text: "\xff\xfe",
    ],
)
def test_a_damaged_file_that_is_named_is_refused_and_no_factory_drive_measured(
    damage, file, refused
):
    """A drive that powers on has its defaults; who names a file wants what it holds."""
    kept = Drive(parameter_file=file)
    kept.write("profile_velocity", 123_456)
    kept.write("save_all_parameters", SAVE)
    file.write_text(damage(file.read_text(encoding="utf-8")), encoding="latin-1")
    with pytest.raises(ValueError, match=r"parameter file .*parameters.json: its? "):
        linear_axis(parameter_file=file)
    assert "take another file" in refused(["bode", "rigid", "--parameter-file", str(file)])
