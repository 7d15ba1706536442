"""A drive on an ideal shaft: an inertia without friction, moved by the torque it is given."""

import atexit
import contextlib
import gc
import os

import numpy as np
import pytest
from hypothesis import settings

from servogym.drive.drive import Drive
from servogym.drive.kernel.words import State

gc.disable()  # until all is collected
os.environ.setdefault("MUJOCO_GL", "egl")  # MuJoCo looks at it when it is imported
with contextlib.suppress(ImportError):
    import triton  # noqa: F401 (its LLVM has to be there before Mesa's, see envs/view/picture.py)

settings.register_profile("ci", deadline=None, max_examples=60, derandomize=True)
settings.register_profile("long", deadline=None, max_examples=10_000)
settings.load_profile("ci")

INERTIA = 0.6e-4  # kg·m², what the generic drive's default gains are made for
INCREMENTS = 1_048_576  # a revolution
TURN = 2 * np.pi


class Shaft:
    """A drive and its shaft; positions in increments, as the generic drive has by default."""

    def __init__(self, model="generic", **arguments):
        self.drive = Drive(model, **arguments)
        self.axis = self.drive.axis
        self.cycle_time = self.drive.model.cycle_time["position"]
        self.periods = int(self.axis.velocity_cycles)
        self.period = float(self.axis.velocity_period)
        self.angle = 0.0
        self.speed = 0.0
        self.inertia = INERTIA  # kg·m²
        self.load = 0.0  # Nm, constant
        self.blocked = None  # angle (rad) of a mechanical stop in the positive direction
        self.torque = 0.0
        self.after = None  # called after every cycle
        self.step()

    def step(self, cycles=1):
        dt = self.period
        for _ in range(cycles):
            self.torque = self.drive.cycle(self.angle, self.speed)
            for _ in range(self.periods):
                self.speed += (self.torque + self.load) / self.inertia * dt
                self.angle += self.speed * dt
                if self.blocked is not None and self.angle > self.blocked:
                    self.angle, self.speed = self.blocked, 0.0
            if self.after:
                self.after()

    def write(self, **values):
        for name, value in values.items():
            self.drive.write(name, value)

    def control(self, word, cycles=2):
        self.drive.write("controlword", word)
        self.step(cycles)

    def enable(self, mode=0):
        self.write(modes_of_operation=mode)
        for word in (0x06, 0x07, 0x0F):
            self.control(word)
        assert self.drive.state == State.OPERATION_ENABLED
        return self

    def home_here(self, position=0):
        """Reference the axis by method 37 with the actual position `position` afterwards."""
        self.write(homing_method=37, home_offset=-position)
        self.enable(6)
        self.control(0x1F, 20)
        self.control(0x0F)
        assert self.axis.homed
        return self

    def until(self, condition, cycles=20_000):
        for n in range(cycles):
            if condition():
                return n
            self.step()
        raise AssertionError(f"not within {cycles} cycles: {self.drive.describe()}")

    def bit(self, mask):  # of the array: attributes of a record in a record take a while
        return bool(int(self.drive.axes["od"]["statusword"][self.drive.index]) & mask)

    def read(self, name):
        return self.drive.read(name)


# tests of one worker, because they share what takes long to load, such as the forked masters
TOGETHER = {
    "torch": (
        "learn/", "policies/test_weights", "evaluate/test_repeat", "cli/test_doors",
        "cli/test_bad_commands", "tasks/test_positioning",
    ),
    "interop": ("interop/",),
    "control": ("autotune/test_bode", "autotune/test_tune", "docs/test_examples"),
}
# what takes longest, first: or one worker waits for it at the end
LONGEST_FIRST = (
    "torch", "test_panel_browser", "interop", "control", "test_memory", "test_pages",
    "test_picture", "test_scope_of_policies", "test_evaluate", "test_jit", "test_policies",
    "test_homing_gallery", "test_every_port", "test_watch", "test_over_ethercat",
)


def group(nodeid):
    """Of a test: the file it is in, or several files."""
    file = nodeid.partition("::")[0]
    return next((name for name, parts in TOGETHER.items() if any(p in file for p in parts)), file)


def pytest_addoption(parser):
    """``--share 3/40``: every 40th test, from the third on."""
    parser.addoption("--share", default="1/1", help="N/M: every M-th test, from the N-th on")


def pytest_collection_modifyitems(config, items):
    """Keep a share, mark each test with its group, sort the groups as workers are to get them."""
    number, _, of = config.getoption("share").partition("/")
    items[:] = items[(int(number) - 1) % int(of) :: int(of)]
    known = {item: group(item.nodeid) for item in items}
    for item, name in known.items():
        item.add_marker(pytest.mark.xdist_group(name))
    first = {
        file: next((n for n, each in enumerate(LONGEST_FIRST) if each in file), len(LONGEST_FIRST))
        for file in dict.fromkeys(known.values())
    }
    items.sort(key=lambda item: first[known[item]])


def pytest_collection_finish():
    """What there is now stays until the end: nobody needs to look through it for garbage."""
    gc.freeze()
    gc.enable()
    gc.set_threshold(20_000, 20, 20)
    atexit.register(gc.unfreeze)  # libraries look then whether all of theirs is gone


@pytest.hookimpl(wrapper=True, optionalhook=True)
def pytest_xdist_auto_num_workers():
    """For ``-n auto``: one more, as tests wait for browsers, buses and processes."""
    return (yield) + 1


@pytest.fixture
def shaft():
    return Shaft()


@pytest.fixture
def enabled():
    return Shaft().enable()


@pytest.fixture
def refused(capsys):
    """Runs a command that has to end with status 2 and one line on stderr, and returns that."""

    def run(words):
        from servogym.training import cli

        try:
            status = cli.main(words)
        except SystemExit as ended:  # of the parser, which shows the usage before
            status = ended.code
        error = capsys.readouterr().err
        assert status == 2
        lines = error.splitlines()[-1:] if error.startswith("usage:") else error.splitlines()
        assert len(lines) == 1, error
        return f"{lines[0]}\n"

    return run


@pytest.fixture
def tell(request):
    """A function that shows a line on the terminal while a long test runs."""
    capture = request.config.pluginmanager.getplugin("capturemanager")

    def show(text):
        with capture.global_and_fixture_disabled():
            print(f"\n{request.node.name}: {text}", end="", flush=True)

    return show if "slow" in request.keywords else lambda text: None


@pytest.fixture(scope="session")
def gl():
    """Skips where no image can be drawn."""
    import mujoco

    try:
        mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8).close()
    except Exception as error:
        pytest.skip(f"no OpenGL here: {type(error).__name__}: {error}")


@pytest.fixture(scope="module")
def browser():
    """Chromium, for the tests of the panel; no page of theirs has an error in its console."""
    from browser import chromium, sync_api

    with sync_api.sync_playwright() as playwright:
        browser = chromium(playwright)
        yield browser
        browser.close()
        assert browser.errors == []
