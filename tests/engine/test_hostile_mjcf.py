"""MJCF from strangers: it opens no file outside its folder, and declares no entities."""

import struct
import zlib

import mujoco
import pytest

from servogym.envs import Machine
from servogym.envs.engine import mjcf_reading as mjcf

AXIS = """<mujoco>{}<worldbody>{}<body><joint name="x" type="slide"/><geom size=".1"/></body>
</worldbody></mujoco>"""
MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def picture():
    """A PNG of one pixel."""
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0)),
              (b"IDAT", zlib.compress(bytes(4))), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


@pytest.fixture
def place(tmp_path):
    """What lies outside, and beside the model, each file with the same content."""
    for folder in (tmp_path, tmp_path / "robot", tmp_path / "robot" / "parts"):
        folder.mkdir(exist_ok=True)
        (folder / "part.obj").write_text(MESH)
        (folder / "pixel.png").write_bytes(picture())
        (folder / "field.bin").write_bytes(struct.pack("<ii4f", 2, 2, 0, 1, 0, 1))
        (folder / "more.xml").write_text(
            "<mujoco><worldbody><body name='more'/></worldbody></mujoco>"
        )
    return tmp_path


WANTS = {
    "include": ('<include file="{}more.xml"/>', ""),
    "include, its name in numbers": ('<include file="{}&#109;ore.xml"/>', ""),
    "mesh": ('<asset><mesh name="m" file="{}part.obj"/></asset>', ""),
    "mesh of a folder": (
        '<compiler meshdir="{}"/><asset><mesh name="m" file="part.obj"/></asset>', ""),
    "texture": ('<asset><texture type="2d" name="t" file="{}pixel.png"/></asset>', ""),
    "texture of a folder": (
        '<compiler assetdir="{}"/><asset><texture type="2d" name="t" file="pixel.png"/></asset>',
        ""),
    "side of a cube": (
        '<asset><texture type="skybox" name="t" fileup="{}pixel.png"/></asset>', ""),
    "height field": ('<asset><hfield name="h" file="{}field.bin" size="1 1 1 1"/></asset>', ""),
    "model": ('<asset><model name="m" file="{}more.xml"/></asset>', ""),
    "flexcomp": ("", '<flexcomp name="f" type="mesh" file="{}part.obj" dim="2" mass="1"/>'),
}


@pytest.mark.parametrize("kind", WANTS)
@pytest.mark.parametrize("outside", ["../", "{}/", "parts/../../"])
def test_a_file_outside_its_folder_is_refused_in_one_line(place, kind, outside):
    robot = place / "robot" / "robot.xml"
    head, body = (part.format(outside.format(place)) for part in WANTS[kind])
    robot.write_text(AXIS.format(head, body))
    with pytest.raises(ValueError, match=r"it wants .*, outside its folder .*folder=") as refusal:
        Machine.from_mjcf(robot, {"x": "generic"})
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("kind", WANTS)
def test_files_beside_it_and_below_are_opened_and_others_when_told(place, kind):
    robot = place / "robot" / "robot.xml"
    for where, folder in (("", None), ("parts/", None), ("../", place)):
        head, body = (part.format(where or "./") for part in WANTS[kind])
        robot.write_text(AXIS.format(head, body))
        assert mjcf.read(robot, folder).joint("x") is not None


def test_an_include_of_an_include_leaves_the_folder_no_more_than_it_may(place):
    robot = place / "robot" / "robot.xml"
    robot.write_text(AXIS.format('<include file="inner.xml"/>', ""))
    (place / "robot" / "inner.xml").write_text('<mujoco><include file="../more.xml"/></mujoco>')
    with pytest.raises(ValueError, match="outside its folder"):
        mjcf.read(robot)
    (place / "robot" / "inner.xml").write_text('<mujoco><include file="inner.xml"/></mujoco>')
    with pytest.raises(ValueError, match="already included"):
        mjcf.read(robot)


def test_a_link_out_of_the_folder_is_outside(place):
    robot = place / "robot" / "robot.xml"
    (place / "robot" / "linked.xml").symlink_to(place / "more.xml")
    robot.write_text(AXIS.format('<include file="linked.xml"/>', ""))
    with pytest.raises(ValueError, match="outside its folder"):
        mjcf.read(robot)


@pytest.mark.parametrize("as_text", [False, True])
def test_entities_are_refused_in_one_line(tmp_path, as_text):
    bomb = '<!ENTITY a "aaaaaaaaaa">' + "".join(
        f'<!ENTITY {name} "{f"&{before};" * 10}">'
        for before, name in zip("abcdefgh", "bcdefghi", strict=True)
    )
    text = f"<!DOCTYPE mujoco [{bomb}]>" + AXIS.format("", '<body name="&i;"/>')
    (tmp_path / "robot.xml").write_text(text)
    with pytest.raises(ValueError, match="declares entities") as refusal:
        Machine.from_mjcf(text if as_text else tmp_path / "robot.xml", {"x": "generic"})
    assert "\n" not in str(refusal.value)


def test_a_file_too_large_is_not_read(tmp_path):
    with (tmp_path / "robot.xml").open("wb") as file:
        file.write(b"<mujoco>")
        file.truncate(mjcf.LARGEST + 1)
    with pytest.raises(ValueError, match=f"{mjcf.LARGEST + 1} bytes, an MJCF file has at most"):
        mjcf.read(tmp_path / "robot.xml")


REPLICATE = "<replicate count='{}' offset='1 0 0'>{}</replicate>"
BOX = "<geom size='.1'/>"
HUGE = {
    "replicate": ("", REPLICATE.format(10**9, BOX)),
    "nested replicate": ("", REPLICATE.format(200, REPLICATE.format(200, BOX))),
    "nested replicate and frames": (
        "",
        REPLICATE.format(999, f"<frame pos='0 0 1'>{REPLICATE.format(999, BOX)}</frame>"),
    ),
    "replicate behind a comment that seems to end one": (
        "",
        REPLICATE.format(999, "<!-- </replicate> -->" + REPLICATE.format(999, BOX)),
    ),
    "composite": ("", "<composite type='cable' count='1000000000 1 1' size='1'/>"),
    "flexcomp": ("", "<flexcomp name='f' type='grid' count='1000 1000 1000' mass='1'/>"),
    "memory": ('<size memory="1E"/>', ""),
    "memory in numbers": ('<size memory="&#49;T"/>', ""),
    "constraints": ('<size njmax="2000000000"/>', ""),
    "user data": ('<size nuserdata="2000000000"/>', ""),
    "numeric": ('<custom><numeric name="n" size="2000000000"/></custom>', ""),
    "texture": (
        '<asset><texture name="t" type="2d" builtin="flat" width="99999" height="99999"/></asset>',
        ""),
    "height field": ('<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>',
        ""),
    "sensor": ('<sensor><user name="s" dim="2000000000"/></sensor>', ""),
}


@pytest.mark.parametrize("kind", HUGE)
def test_counts_and_sizes_without_end_are_refused_before_mujoco_sees_them(kind, monkeypatch):
    monkeypatch.setattr(mujoco.MjSpec, "from_string", None)  # nothing comes that far
    with pytest.raises(ValueError, match=r": <[a-z]+>: its (counts|sizes) .* at most$") as refusal:
        Machine.from_mjcf(AXIS.replace("\n", "").format(*HUGE[kind]), {"x": "generic"})
    assert "\n" not in str(refusal.value)


def test_an_include_counts_as_often_as_what_is_around_it(place):
    robot = place / "robot" / "robot.xml"
    inner = f"<mujoco><worldbody>{REPLICATE.format(500, BOX)}</worldbody></mujoco>"
    (place / "robot" / "inner.xml").write_text(inner)
    for times, refused in ((20, False), (200, True)):
        robot.write_text(AXIS.format("", REPLICATE.format(times, '<include file="inner.xml"/>')))
        asked = mjcf._Asked()
        base = robot.parent
        call = (robot.read_text(), base, base.resolve(), {robot.resolve()}, asked, 1.0)
        if refused:
            with pytest.raises(ValueError, match="elements, 20000 at most"):
                mjcf._opened(*call)
        else:
            mjcf._opened(*call)
            assert asked.copies == 20 + 20 * 500


def test_counts_that_a_robot_has_are_taken():
    text = AXIS.format('<size memory="10M"/>', REPLICATE.format(50, REPLICATE.format(3, BOX)))
    machine = Machine.from_mjcf(text, {"x": "generic"})
    assert machine.model.ngeom == 151


def test_a_picture_that_claims_to_be_huge_is_not_opened(place):
    robot = place / "robot" / "robot.xml"
    data = bytearray(picture())
    data[16:24] = struct.pack(">II", 65535, 65535)
    (place / "robot" / "pixel.png").write_bytes(data)
    texture = '<asset><texture type="2d" name="t" file="pixel.png"/></asset>'
    robot.write_text(AXIS.format(texture, ""))
    with pytest.raises(ValueError, match=f"a file of a model at most {mjcf.LARGEST_ASSET}"):
        mjcf.read(robot)


def test_nesting_without_end_is_refused():
    with pytest.raises(ValueError, match="nesting is too deep"):
        mjcf.read("<mujoco><worldbody>" + "<body>" * 20_000)


def test_the_specs_that_mujoco_itself_reads_are_the_same(place):
    robot = place / "robot" / "robot.xml"
    robot.write_text(AXIS.format('<include file="more.xml"/>', ""))
    plain = mujoco.MjSpec.from_file(str(robot))
    view = plain.visual.global_
    view.offwidth, view.offheight = mjcf.WIDTH, mjcf.HEIGHT  # room for our pictures
    assert mjcf.read(robot).to_xml() == plain.to_xml()
