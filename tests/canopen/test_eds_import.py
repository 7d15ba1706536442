"""A drive model made from an EDS: our own models there and back, foreign and hostile files."""

import re

import pytest

from servogym.drive.canopen import eds
from servogym.drive.drive import Drive
from servogym.drive.imports.eds import import_eds
from servogym.drive.master import Master
from servogym.drive.model.model import load, model_names
from servogym.drive.objects.abort import SdoAbort
from servogym.envs import linear_axis
from servogym.envs.masters.port import MachinePort

MODELS = [name for name in model_names() if "can" in load(name).buses]
# computed by the drive, in ways that an EDS has no words for
COMPUTED = ("act_string", "error_reaction", "outputs")


def answer(drive, row):
    try:
        return drive.read(row.index, row.subindex)
    except SdoAbort as abort:
        return abort.code


@pytest.mark.parametrize("name", MODELS)
def test_our_own_models_come_back_with_the_same_answers(name, tmp_path):
    eds.write(name, tmp_path / "drive.eds")
    made = import_eds(tmp_path / "drive.eds", tmp_path / "mine")
    assert made.left_out == ()
    own, back = Drive(name, bus="can"), Drive(made.folder)
    rows = [row for row in eds.rows(own.model) if row.access != "wo"]
    assert made.objects >= len(rows)
    # factors of 0, which nothing can be divided by; the README tells each
    repaired = {r.where for r in made.repairs if r.says == "default 0"}
    differ = [
        f"{row.index:04X}h:{row.subindex:02X} {row.name}"
        for row in rows
        if answer(own, row) != answer(back, row)
        and not (row.hook in COMPUTED or (row.index == 0x1003 and row.subindex))
        and f"{row.index:04X}h:{row.subindex:02X}h" not in repaired
    ]
    assert differ == []
    page = (made.folder / "README.md").read_text(encoding="utf-8")
    assert "`inferred`" in page
    assert all(f"- {item}\n" in page for item in made.unknown)


def without(text, index):
    """An EDS less an object."""
    text = re.sub(rf"\[{index}(sub\w+)?\]\n(?:(?!\[).*\n)*", "", text)
    for name in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        section = re.search(rf"\[{name}\]\n((?:(?!\[).*\n)*)", text)
        listed = [x for x in re.findall(r"^\d+=(\S+)", section[1], re.M) if index not in x.upper()]
        body = f"SupportedObjects={len(listed)}\n"
        body += "".join(f"{n}={x}\n" for n, x in enumerate(listed, 1))
        text = text.replace(section[0], f"[{name}]\n{body}\n")
    return text


def test_a_drive_without_60c2h_moves_an_axis(tmp_path):
    file = tmp_path / "drive.eds"
    eds.write("generic", file)
    file.write_text(without(file.read_text(encoding="utf-8"), "60C2"), encoding="utf-8")
    folder = import_eds(file, tmp_path / "mine").folder
    machine = linear_axis(folder)
    machine.reset(positions={"x": 0.1})
    with pytest.raises(SdoAbort):
        machine.drives["x"].read(0x60C2, 1)
    master = Master(MachinePort(machine), "x")
    master.enable()
    master.move_to(0.05, relative=True)
    assert machine.data.qpos[0] == pytest.approx(0.15, abs=1e-3)


def text_of(tmp_path):
    eds.write("generic", tmp_path / "good.eds")
    return (tmp_path / "good.eds").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda text: text[: len(text) // 3], r"bad.eds, line \d+: 6040h is .*file complete\?"),
        (lambda text: "", "bad.eds, line 1: .* it is not an EDS"),
        (lambda text: "\0\1\2" * 500, "it is binary"),
        (lambda text: text + ";" * 10_000_000, "bytes, an EDS has at most"),
        (lambda text: "[FileInfo]\nFileName=x.eds\n", "it is not an EDS"),
        (lambda text: text.replace("[6040]", "[604"), "6040h is listed, but has no section"),
        (lambda text: without(text, "6041"), "6041h is missing: it is not the EDS"),
        (
            lambda text: "\n".join(text[i : i + 7] for i in range(0, 4000, 7)),
            r"line \d+: .* is missing|not an EDS",
        ),
    ],
)
def test_what_is_no_eds_is_refused_in_one_line_and_leaves_nothing(spoil, reason, tmp_path, refused):
    file, folder = tmp_path / "bad.eds", tmp_path / "mine"
    file.write_text(spoil(text_of(tmp_path)), encoding="utf-8")
    before = sorted(tmp_path.iterdir())
    error = refused(["drives", "--from-eds", str(file), "-o", str(folder)])
    assert re.search(reason, error), error
    assert sorted(tmp_path.iterdir()) == before


def test_names_in_an_eds_are_text_and_no_paths(tmp_path):
    text = text_of(tmp_path)
    text = re.sub(r"ProductName=.*", 'ProductName=../../"evil"\\\\n[x]', text)
    text = re.sub(r"ParameterName=following_error_window", "ParameterName=../../etc/passwd", text)
    (tmp_path / "drive.eds").write_text(text, encoding="utf-8")
    made = import_eds(tmp_path / "drive.eds", tmp_path / "mine")
    assert load(made.folder).title.startswith("../../")
    assert sorted(x.name for x in made.folder.iterdir()) == [
        "README.md", "drive.toml", "objects.csv", "pdo.csv",
    ]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--from-eds", "nowhere.eds", "-o", "new"], "there is no such file"),
        (["--from-eds", "good.eds"], "belong together"),
        (["--from-eds", "good.eds", "-o", "."], "exists already"),
        (["--from-eds", "good.eds", "-o", "no/where"], "there is no folder"),
    ],
)
def test_wrong_options_are_one_line(arguments, text, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    text_of(tmp_path)
    assert text in refused(["drives", *arguments])


def test_one_object_more_is_one_row_more(tmp_path):
    (tmp_path / "drive.toml").write_text('based_on = "generic"\ntitle = "My drive"\n')
    header = (load("generic").folder / "objects.csv").read_text(encoding="utf-8").split("\n")[0]
    row = "0x5000,0x00,spindle_pitch,VAR,UNSIGNED32,rw,,µm,1,100000,5000,yes,4.2,,,,"
    (tmp_path / "objects.csv").write_text(f"{header}\n{row}\n", encoding="utf-8")
    mine, base = load(tmp_path), load("generic")
    assert set(mine.objects) - set(base.objects) == {(0x5000, 0)}
    assert Drive(tmp_path).read("spindle_pitch") == 5000
