"""`servogym watch`: what it writes, what it says, and whom it lets act."""

import os
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from servogym.envs.view import picture
from servogym.training import cli, watch
from servogym.training.pictures.video import Gif, recording
from servogym.training.policies import make

STEERING = "def steer(seen):\n    return (4 * seen[:1]).clip(-0.4, 0.4)\n\nnumber = 3\n"


@pytest.fixture
def pictures(monkeypatch):
    """Stands for drawing, which is slow without a graphics card: images counted in their pixels."""
    drawn = []

    def image(self):
        drawn.append(self)
        return np.full((54, 96, 3), len(drawn), np.uint8)

    monkeypatch.setattr(picture.Picture, "image", image)
    return drawn


@pytest.fixture
def steering(tmp_path):
    file = tmp_path / "steering.py"
    file.write_text(STEERING)
    return file


def test_a_small_part_keeps_its_colour_among_many_greys(tmp_path):
    grey = np.linspace(40, 230, 960)[None, :, None] * np.linspace(0.7, 1.0, 540)[:, None, None]
    image = np.repeat(grey, 3, axis=2).astype(np.uint8)
    image[300:310, 300:310] = orange = (201, 134, 26)
    gif = Gif(tmp_path / "run.gif", 25)
    for _ in range(2):
        gif.add(image)
    gif.close()
    with Image.open(tmp_path / "run.gif") as found:
        seen = np.asarray(found.convert("RGB"), float)
    np.testing.assert_allclose(seen[300:310, 300:310].mean((0, 1)), orange, atol=12)
    rows, columns = 4 * 130, 4 * 235  # whole rasters; what is dithered is right on average
    blocks = [x[:rows, :columns].reshape(130, 4, 235, 4, 3).mean((1, 3)) for x in (seen, image)]
    assert np.abs(blocks[0] - blocks[1]).max(axis=2)[:70].max() < 12


def test_a_gif_shows_each_25th_of_a_second_and_the_end(gl, tmp_path, capsys):
    out = tmp_path / "new" / "run.gif"
    arguments = ["watch", "LinearAxis-v0", "--policy", "random", "--seed", "0"]
    assert cli.main([*arguments, "--record", str(out)]) == 0
    said = capsys.readouterr().out
    assert "8611h following error" in said
    steps = int(said.split()[2])
    with Image.open(out) as gif:
        assert gif.size == (960, 540)
        assert gif.n_frames == 1 + -(-steps // 8)
        assert gif.info["duration"] == 40


@pytest.mark.parametrize(("speed", "count"), [("1", 26), ("0.2", 101), ("4", 8)])
def test_a_folder_gets_the_images_of_all_episodes(pictures, tmp_path, speed, count, capsys):
    arguments = ["watch", "servogym/LinearAxis-v0", "--episodes", "2", "--speed", speed]
    assert cli.main([*arguments, "--record", str(tmp_path / "out")]) == 0
    files = sorted(file.name for file in (tmp_path / "out").iterdir())
    assert len(files) == len(pictures) == 2 * count
    assert files[0] == "00000.png"
    assert np.asarray(Image.open(tmp_path / "out" / "00002.png"))[0, 0, 0] == 3
    said = capsys.readouterr().out
    assert said.count("200 steps, 1.000 s, return") == 2
    assert f"{2 * count} images" in said


def test_an_mp4_has_the_images_and_the_speed(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="no encoder: servogym[video]")
    writer = recording(tmp_path / "run.mp4", 25.0)
    for shade in range(0, 250, 10):
        writer.add(np.full((54, 96, 3), shade, np.uint8))
    writer.close()
    reader = ffmpeg.read_frames(str(tmp_path / "run.mp4"))
    about = next(reader)
    reader.close()  # before its end: it leaves the pipes of a process that has ended open
    assert (about["fps"], about["size"]) == (25.0, (96, 54))
    assert ffmpeg.count_frames_and_secs(str(tmp_path / "run.mp4")) == (25, 1.0)


def test_a_policy_from_a_file_reaches_the_goal(pictures, steering, tmp_path, capsys):
    arguments = ["watch", "LinearAxis-v0", "--record", str(tmp_path / "out"), "--policy"]
    assert cli.main([*arguments, f"{steering}:steer"]) == 0
    assert ", success" in capsys.readouterr().out
    assert cli.main([*arguments, "hold"]) == 0
    assert ", no success" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["Nothing-v0"], "unknown environment 'Nothing-v0': did you mean Homing-v0"),
        (["LinearAxis-v0", "--policy", "nothing"], "choose one of hold, random, trapezoid"),
        (["Homing-v0", "--policy", "built_in"], "there is nothing to watch"),
        (["LinearAxis-v0", "--policy", "no.py:act"], "there is no Python file no.py"),
        (["LinearAxis-v0", "--drive", "bonfiglioli_act"], "has no mode cyclic_sync_position"),
        (["LinearAxis-v0", "--episodes", "0"], "--episodes: 0 is out of range 1.."),
        (["LinearAxis-v0", "--speed", "nan"], "--speed: 'nan' is not a finite number"),
        (["LinearAxis-v0", "--record", "out.avi"], "use .mp4, .gif, or a folder"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_fix(arguments, says, refused):
    assert says in refused(["watch", *arguments])


@pytest.mark.parametrize(
    ("text", "function", "says"),
    [
        (STEERING, "other", "has no function 'other', only steer"),
        (STEERING, "number", "has no function 'number'"),
        ("import nothing_at_all", "steer", "fails: .*, line 1.*: ModuleNotFoundError"),
        ("def steer(:", "steer", "fails: .*, line 1: SyntaxError"),
    ],
)
def test_a_file_without_such_a_policy_is_named(text, function, says, tmp_path):
    file = tmp_path / "steering.py"
    file.write_text(text)
    env = gym.make("servogym.envs:servogym/LinearAxis-v0")
    with pytest.raises(ValueError, match=says):
        make(f"{file}:{function}", env.unwrapped)


def test_an_mp4_without_encoder_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert cli.main(["watch", "LinearAxis-v0", "--record", str(tmp_path / "out.mp4")]) == 2
    assert "pip install 'servogym[video]', or record a .gif" in capsys.readouterr().err


@pytest.mark.skipif("sys.platform != 'linux'", reason="elsewhere a window needs no variable")
def test_without_a_display_it_says_to_record(monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert cli.main(["watch", "LinearAxis-v0"]) == 2
    assert "--record out.gif" in capsys.readouterr().err


def test_a_window_runs_in_real_time_until_it_is_closed(monkeypatch, capsys):
    clock, shown = [100.0], []

    def sleep(seconds):
        clock[0] += seconds

    def show(self):
        shown.append(clock[0])
        clock[0] += 0.013  # s, drawing takes its time

    monkeypatch.setattr(watch.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(watch.time, "sleep", sleep)
    monkeypatch.setattr(picture, "require_display", lambda: None)
    monkeypatch.setattr(picture.Picture, "show", show)
    monkeypatch.setattr(picture.Picture, "closed", property(lambda self: len(shown) == 20))
    arguments = ["watch", "LinearAxis-v0", "--speed", "0.5", "--episodes", "3"]
    assert cli.main(arguments) == 0
    assert np.diff(shown) == pytest.approx(0.04)
    assert "episode 1: 76 steps, 0.380 s" in capsys.readouterr().out


@pytest.mark.parametrize("how", ["watch", "gymnasium"])
def test_without_a_display_and_without_a_word_a_picture_is_drawn(how, tmp_path, gl):
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY")}
    environment.pop("WAYLAND_DISPLAY", None)
    code = {
        "watch": "from servogym.training import cli; import sys; sys.exit(cli.main(["
        "'watch', 'LinearAxis-v0', '--policy', 'random', '--record', 'run.gif', '--speed', '10']))",
        "gymnasium": "import mujoco, gymnasium; env = gymnasium.make("
        "'servogym.envs:servogym/LinearAxis-v0', render_mode='rgb_array'); env.reset(seed=0); "
        "image = env.render(); assert image.std() > 10; open('run.gif', 'wb').write(b'x')",
    }[how]
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "run.gif").stat().st_size > 0
