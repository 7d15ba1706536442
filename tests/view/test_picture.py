"""Pictures and windows: what they say, that they follow the state, that they disturb nothing."""

import contextlib
import os
import subprocess
import sys
import types
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from PIL import Image

from servogym.drive.kernel.words import Limit, State
from servogym.drive.master import Master
from servogym.envs import gantry, linear_axis, rotary_axis
from servogym.envs.masters.port import MachinePort
from servogym.envs.tasks import GantryContourEnv, LinearAxisEnv, RobotEnv
from servogym.envs.view import picture
from servogym.envs.view.camera import framed, visible_points
from servogym.envs.view.decor import BOX, parts
from servogym.envs.view.overlay import (
    BAR,
    BAR_WIDTH,
    FRAME,
    HEAD,
    INSET,
    LIMIT,
    LIMIT_NAME,
    MODE,
    ROW,
    STATE,
    STATE_COLOUR,
    Overlay,
    lines,
)
from servogym.envs.view.picture import HEIGHT, WIDTH

ID = "servogym.envs:servogym/LinearAxis-v0"
START = {"start": 0.1, "goal": 0.4}
FAST = np.full(1, 0.6, np.float32)  # of the maximum velocity at once: at the torque limit


def overlay(machine, title="", goal="", right=""):
    """The overlay alone, on black."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    Overlay(list(machine.drives), WIDTH).draw(image, lines(machine), title, goal, right)
    return image


def columns(image, begin, end):
    """The part of the last line between two places."""
    return image[-ROW - 6 : -6, begin:end]


@pytest.fixture
def env():
    env = LinearAxisEnv()
    env.reset(seed=1, options=START)
    return env


def test_a_line_says_what_the_objects_say(env):
    for _ in range(3):
        env.step(FAST)
    (line,) = lines(env.machine)
    x = env.drive
    assert (line.name, line.state, line.mode) == (
        "x", State.OPERATION_ENABLED, "cyclic sync position",
    )
    assert 1e3 * line.error == pytest.approx(x.read("following_error_actual_value"), abs=1.0)
    assert (line.window, line.unit) == (20.0, "mm")
    assert line.limits == "torque"
    assert x.axis.od.active_limits == Limit.TORQUE
    assert line.fault == ""


def test_every_limit_and_every_state_can_be_shown():
    assert LIMIT_NAME.keys() == set(Limit)
    assert STATE_COLOUR.keys() == set(State)


def test_a_window_switched_off_is_said_and_drawn(env):
    env.drive.write("following_error_window", 0xFFFFFFFF)
    env.step(FAST)
    (line,) = lines(env.machine)
    assert line.numbers.endswith("/ off mm")
    overlay(env.machine)


def test_a_window_of_zero_has_every_error_outside(env):
    line = lines(env.machine)[0]._replace(window=0.0)
    none, some = np.zeros((2, HEIGHT, WIDTH, 3), np.uint8)
    Overlay(["x"], WIDTH).draw(none, [line._replace(error=0.0)], "", "", "")
    Overlay(["x"], WIDTH).draw(some, [line._replace(error=-1e-3)], "", "", "")
    assert columns(none, BAR, BAR + 1)[14].max() < 100
    assert columns(some, BAR, BAR + 1)[14].max() > 200


def test_a_machine_just_powered_on_can_be_drawn():
    assert overlay(gantry())[-20:].any()


def test_the_parts_of_the_overlay_change_with_what_they_show(env):
    env.step(np.zeros(1, np.float32))
    rest = overlay(env.machine)
    for _ in range(3):
        env.step(FAST)
    moving = overlay(env.machine)
    for begin, end, changes in (
        (STATE, MODE, False), (MODE, BAR, False), (BAR, BAR + BAR_WIDTH, True), (LIMIT, WIDTH, True)
    ):
        before, after = (columns(image, begin, end) for image in (rest, moving))
        assert (before != after).any() == changes
    env.drive.inject("overvoltage")
    env.step(FAST)
    fault = overlay(env.machine)
    assert (columns(fault, STATE, MODE) != columns(moving, STATE, MODE)).any()
    red = tuple(bytes.fromhex(STATE_COLOUR[State.FAULT][1:]))
    assert tuple(fault[HEAD + 1, WIDTH - 2]) == red, "the fault is named in a red bar"
    assert not moving[HEAD:-100].any(), "without a fault there is none"


def test_the_bar_grows_with_the_following_error_and_turns_red_outside_the_window(env):
    widths, reds = [], []
    for share in (0.0, 0.01, 0.25, 1.0, 4.0):
        line = lines(env.machine)[0]
        image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        line = line._replace(error=share * line.window)
        Overlay(["x"], WIDTH).draw(image, [line], "", "", "")
        bar = columns(image, BAR + BAR_WIDTH // 2 + 2, BAR + BAR_WIDTH)[14].astype(int)
        filled = np.abs(bar - bar[-1]).sum(axis=1) > 150
        widths.append(int(filled.sum()) if share < 4 else BAR_WIDTH)
        reds.append(bool(bar[0, 0] > 200))
    assert widths == sorted(set(widths))
    assert reds == [False, False, False, False, True]


def test_a_gantry_has_a_line_for_each_drive(env):
    machine = gantry()
    Master(MachinePort(machine), "y").enable()
    states = [line.state for line in lines(machine)]
    assert states == [
        State.SWITCH_ON_DISABLED, State.OPERATION_ENABLED, State.SWITCH_ON_DISABLED,
    ]
    three, one = (overlay(m)[HEAD:].any(axis=(1, 2)).sum() for m in (machine, env.machine))
    assert three - one == 2 * ROW


def test_long_names_and_texts_stay_in_their_columns(env):
    line = lines(env.machine)[0]
    one, other = np.zeros((2, HEIGHT, WIDTH, 3), np.uint8)
    endless = "very " * 100
    Overlay(["x"], WIDTH).draw(one, [line._replace(limits=endless)], "T", endless, "reward 1.00")
    Overlay(["x"], WIDTH).draw(other, [line], "T", "", "reward 1.00")
    np.testing.assert_array_equal(columns(one, 0, LIMIT), columns(other, 0, LIMIT))
    np.testing.assert_array_equal(one[:HEAD, -100:], other[:HEAD, -100:])
    np.testing.assert_array_equal(one[:HEAD, :40], other[:HEAD, :40])


def test_images_have_their_shape_and_follow_the_goal(gl):
    env = gym.make(ID, render_mode="rgb_array")
    env.reset(seed=1, options=START)
    image = env.render()
    assert (image.shape, image.dtype) == ((HEIGHT, WIDTH, 3), np.uint8)
    env.reset(seed=1, options=START | {"goal": 0.2})
    other = env.render()
    assert (image[100:400] != other[100:400]).any(), "the ghost has moved"
    assert (image[:HEAD] != other[:HEAD]).any(), "the distance has changed"
    env.close()
    env.close()


def test_a_contour_is_drawn_with_what_was_driven_step_by_step(gl):
    env = GantryContourEnv(render_mode="rgb_array")
    env.reset(seed=2)
    before = env.render()
    for _ in range(150):
        env.step(np.zeros(3, np.float32))  # half of the feed
    image = env.render()
    env.close()
    red = [(each[..., 0] > 150) & (each[..., 1] < 110) & (each[..., 2] < 110)
           for each in (before, image)]
    corner = slice(HEAD + 12, HEAD + 12 + INSET), slice(WIDTH - INSET - 12, WIDTH - 12)
    floor = slice(HEIGHT // 2, HEIGHT - 115), slice(0, WIDTH - INSET - 24)
    assert red[0][corner].sum() < 5
    assert red[1][corner].sum() > 60
    assert red[1][floor].sum() > red[0][floor].sum() + 5
    if folder := os.environ.get("SERVOGYM_PICTURES"):
        small = Image.fromarray(image).quantize(128)
        small.save(Path(folder) / "recording_contour.png", optimize=True)


def test_drawing_changes_nothing_bit_for_bit(gl):
    plain, drawn = LinearAxisEnv(), LinearAxisEnv(render_mode="rgb_array")
    for env in (plain, drawn):
        env.reset(seed=3)
    for action in np.random.default_rng(0).uniform(-0.5, 0.5, (10, 1)).astype(np.float32):
        drawn.render()
        np.testing.assert_array_equal(plain.step(action)[0], drawn.step(action)[0])
    assert plain.machine.snapshot() == drawn.machine.snapshot()
    drawn.close()


def _differing(one, other):
    """Share of the pixels."""
    return (one != other).any(axis=2).mean()


def test_a_vector_environment_draws_each_of_its_machines(gl):
    envs = gym.make_vec(ID, 3, render_mode="rgb_array", threads=2)
    alone = gym.make_vec(ID, 3, threads=2)
    envs.reset(seed=5)
    alone.reset(seed=5)
    for action in np.linspace(-0.5, 0.5, 3, dtype=np.float32):
        images = envs.render()
        actions = np.full((3, 1), action)
        np.testing.assert_array_equal(envs.step(actions)[0], alone.step(actions)[0])
    assert len(images) == 3
    assert min(_differing(images[i], images[i - 1]) for i in range(3)) > 1e-3
    single = LinearAxisEnv(render_mode="rgb_array")
    single.reset(seed=6)
    for action in np.linspace(-0.5, 0.5, 3, dtype=np.float32)[:2]:
        single.step(np.full(1, action))
    # the software rasteriser may give a pixel of an edge to either side
    assert _differing(single.render(), images[1]) < 1e-4
    envs.close()
    single.close()


def test_images_a_second_are_the_steps_of_a_second():
    assert LinearAxisEnv().metadata["render_fps"] == 200
    assert LinearAxisEnv(step_time=0.02).metadata["render_fps"] == 50
    envs = gym.make_vec(ID, 2, step_time=0.02)
    assert envs.metadata["render_fps"] == 50
    envs.close()


def test_record_video_gets_every_image(gl, tmp_path, monkeypatch):
    # what is tested is the wrapper's side; the encoder itself is stood in for where it is missing
    clips = []

    class Clip:
        def __init__(self, frames, fps):
            clips.append((len(frames), frames[0].shape, fps))

        def write_videofile(self, path, logger):
            pass

    names = ("moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.ImageSequenceClip")
    for name in names:
        module = types.ModuleType(name)
        module.ImageSequenceClip = Clip
        monkeypatch.setitem(sys.modules, name, module)
    env = gym.wrappers.RecordVideo(
        gym.make(ID, render_mode="rgb_array", max_episode_steps=4), str(tmp_path / "video")
    )
    env.reset(seed=1)
    for _ in range(4):
        env.step(np.zeros(1, np.float32))
    env.close()
    assert clips == [(5, (HEIGHT, WIDTH, 3), 200)]


def test_a_contour_is_seen_from_above_with_what_was_driven():
    whole = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    angle = np.linspace(0, 2 * np.pi, 90)
    circle = 0.04 * np.column_stack([np.cos(angle), np.sin(angle)]) + (0.4, 0.25)
    overlay = Overlay(["x"], WIDTH)
    overlay.inset(whole, circle, [circle[:45]])  # the upper half
    red = (whole[..., 0] > 200) & (whole[..., 1] < 120)
    rows, places = np.nonzero(red)
    corner = HEAD + 12, WIDTH - INSET - 12
    assert rows.min() > corner[0]
    assert places.min() > corner[1]
    assert rows.max() < corner[0] + INSET / 2
    assert np.ptp(places) == pytest.approx(INSET - 2 * FRAME, abs=4)
    assert not whole[:, : corner[1]].any()


# ------------------------------------------------------------------------- the machine


@pytest.mark.parametrize(
    "make", [linear_axis, rotary_axis, gantry, lambda: RobotEnv().machine],
    ids=["linear", "rotary", "gantry", "arm"],
)
def test_the_camera_has_the_machine_and_all_its_motion_in_sight(make):
    machine = make()
    model, below, above = machine.model, 0.25, 0.06
    camera = framed(model, machine.data, WIDTH / HEIGHT, below, above)
    turn, lift = np.radians([camera.azimuth, camera.elevation])
    ahead = np.array([np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)])
    right = np.array([np.sin(turn), -np.cos(turn), 0])
    half = np.tan(np.radians(float(model.vis.global_.fovy)) / 2)
    away = visible_points(model, machine.data) - (camera.lookat - camera.distance * ahead)
    depth = away @ ahead
    across = (away @ right) / (depth * half * WIDTH / HEIGHT)
    upward = (away @ np.cross(right, ahead)) / (depth * half)
    assert np.abs(across).max() < 1
    assert upward.max() < 1 - 2 * above
    assert upward.min() > -1 + 2 * below
    assert max(np.ptp(across), np.ptp(upward) / (1 - below - above)) > 0.8  # and fills it


@pytest.mark.parametrize("make", [linear_axis, rotary_axis, gantry])
def test_a_plant_is_decorated_at_its_bodies_and_weighs_what_it_did(make):
    machine = make()
    found = parts(machine.model)
    assert {machine.model.body(part.body).name for part in found} > {"world"}
    assert all(min(part.size[: 3 if part.kind == BOX else 2]) > 0 for part in found)
    assert len(found) < 120  # each costs time in a picture
    assert not parts(mujoco.MjModel.from_xml_string("<mujoco model='another'/>"))


def ghosts_of(env):
    """Places and shapes of what is translucent in the picture."""
    scene = mujoco.MjvScene(env.machine.model, 100)
    drawn = picture.Picture(env)
    drawn._ghosts(scene)
    return [(geom.type, geom.pos.copy(), geom.mat.copy()) for geom in scene.geoms[: scene.ngeom]]


@pytest.mark.parametrize("goals", [None, ["elbow"]])
def test_a_robot_has_its_goal_pose_as_a_ghost(goals):
    """Where MuJoCo has the geoms of a second robot that stands at the goal."""
    env = RobotEnv(goals=goals)
    env.reset(seed=3)
    robot, there = env.machine.model, mujoco.MjData(env.machine.model)
    there.qpos[:] = env.episode._goal[: robot.nq]
    mujoco.mj_kinematics(robot, there)
    moved = [g for g in range(robot.ngeom) if not np.allclose(
        [*there.geom_xpos[g], *there.geom_xmat[g]],
        [*env.machine.data.geom_xpos[g], *env.machine.data.geom_xmat[g]], atol=1e-5)]
    drawn = ghosts_of(env)
    assert len(drawn) == len(moved) > 0
    for geom, (_, place, turn) in zip(moved, drawn, strict=True):
        np.testing.assert_allclose(place, there.geom_xpos[geom], atol=1e-6)
        np.testing.assert_allclose(turn.ravel(), there.geom_xmat[geom], atol=1e-6)
    env.machine.data.qpos[:] = there.qpos
    mujoco.mj_kinematics(robot, env.machine.data)
    assert not ghosts_of(env), "what has arrived has none"


def test_a_site_of_a_robot_has_a_mark_at_its_goal():
    env = RobotEnv(site="tool")
    env.reset(seed=3, options={"goal": (0.3, 0.1, 0.4)})
    ((kind, place, _),) = ghosts_of(env)
    assert kind == mujoco.mjtGeom.mjGEOM_SPHERE
    np.testing.assert_allclose(place, (0.3, 0.1, 0.4), atol=1e-6)


# ------------------------------------------------------------------------- the window


class Window:
    """Stands for the passive viewer of MuJoCo, which needs a display."""

    def __init__(self, model, data, **_):
        mujoco.mj_forward(model, data)  # as launch_passive does
        self.user_scn = mujoco.MjvScene(model, 100)
        self.cam = mujoco.MjvCamera()
        self.texts, self.syncs, self.open = [], 0, True

    def lock(self):
        return contextlib.nullcontext()

    def is_running(self):
        return self.open

    def set_texts(self, texts):
        self.texts = texts

    def sync(self):
        self.syncs += 1

    def close(self):
        self.open = False


@pytest.fixture
def windows(monkeypatch):
    import mujoco.viewer

    opened = []
    monkeypatch.setattr(picture, "require_display", lambda: None)
    monkeypatch.setattr(
        mujoco.viewer,
        "launch_passive",
        lambda *a, **k: opened.append(Window(*a, **k)) or opened[-1],
    )
    return opened


def test_a_window_shows_ghost_and_texts_and_changes_nothing(windows):
    plain, watched = LinearAxisEnv(), LinearAxisEnv(render_mode="human")
    for env in (plain, watched):
        env.reset(seed=3, options=START)
    for _ in range(6):
        np.testing.assert_array_equal(plain.step(FAST)[0], watched.step(FAST)[0])
    (window,) = windows
    assert window.syncs == 7
    drawn = [geom.rgba.tolist() for geom in window.user_scn.geoms[: window.user_scn.ngeom]]
    assert drawn.count(picture.GHOST.tolist()) == 1
    assert drawn.count(picture.DRIVEN.tolist()) > 1
    (_, _, title, _), (_, _, drives, limits) = window.texts
    assert "LinearAxis-v0" in title
    assert "carriage" in title
    assert drives.startswith("x  operation enabled  cyclic sync position")
    assert drives.isascii()
    assert limits == "limit torque"
    watched.close()
    assert not window.open


def test_an_episode_goes_on_when_the_user_closes_the_window(windows):
    env = LinearAxisEnv(render_mode="human")
    env.reset(seed=3)
    windows[0].open = False
    env.step(FAST)
    env.reset()
    assert len(windows) == 1, "it is not opened again"
    assert windows[0].syncs == 1
    env.close()


def test_images_open_no_window(gl, windows):
    env = LinearAxisEnv(render_mode="rgb_array")
    env.reset(seed=3)
    env.render()
    env.step(FAST)
    env.close()
    assert not windows


@pytest.mark.skipif("sys.platform != 'linux'", reason="elsewhere a window needs no variable")
def test_without_a_display_the_next_step_is_named(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    env = LinearAxisEnv(render_mode="human")
    with pytest.raises(RuntimeError, match=r"no display.*rgb_array.*--record"):
        env.reset(seed=1)


def test_without_opengl_the_next_step_is_named(monkeypatch):
    def missing(*_):
        raise RuntimeError("no EGL device")

    monkeypatch.setattr(mujoco, "Renderer", missing)
    env = LinearAxisEnv(render_mode="rgb_array")
    env.reset(seed=1)
    with pytest.raises(RuntimeError, match=r"no EGL device.*MUJOCO_GL"):
        env.render()


FIRST_OUR_PICTURE = """
from servogym.envs.tasks import GantryContourEnv, LinearAxisEnv, RobotEnv
env = LinearAxisEnv(render_mode="rgb_array")
env.reset(seed=0)
env.render()
import triton
"""
FIRST_ANOTHER_PICTURE = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco/>")
renderer = mujoco.Renderer(model)
renderer.update_scene(mujoco.MjData(model))
renderer.render()
from servogym.envs.tasks import GantryContourEnv, LinearAxisEnv, RobotEnv
env = LinearAxisEnv(render_mode="rgb_array")
env.reset(seed=0)
env.render()
"""


@pytest.mark.parametrize("code", [FIRST_OUR_PICTURE, FIRST_ANOTHER_PICTURE])
def test_mesa_and_triton_do_not_end_the_process(code):
    pytest.importorskip("triton", reason="comes with torch on Linux")
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=300)
    assert ended.returncode == 0, ended.stderr.decode()[-2000:]
