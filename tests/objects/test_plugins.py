"""What a model folder brings: hooks, by consent only; writes by SDO and by PDO are one thing."""

import subprocess
import sys

import pytest

from servogym.drive import Drive, SdoAbort, run_code
from servogym.drive.kernel.words import Mode, mode_bit

HEAD = (
    "index,subindex,name,object_type,data_type,access,pdo,unit,min,max,default,storable,section,"
    "note,field,when,hook\n"
)
HOOKS = """
from servogym.drive import Abort, Hook

def write(od, row, value):
    if value == 3:
        return Abort.DEVICE_STATE
    od.drive.axis.od.max_torque = 100 * value
    return Abort.NONE

def read(od, row):
    return int(od.drive.axis.od.max_torque) // 100

HOOKS = {"strength": Hook(write, read)}
"""


def folder(tmp_path, pdo="", hook="", hooks=HOOKS, sub="own"):
    own = tmp_path / sub
    own.mkdir()
    (own / "drive.toml").write_text('based_on = "generic"\n')
    (own / "objects.csv").write_text(
        f"{HEAD}0x5000,0x00,strength,VAR,UNSIGNED8,rw,{pdo},,0,10,1,,mine,,,,{hook}\n"
        "0x5001,0x00,offset,VAR,INTEGER16,rw,rxtx,,-5,5,0,,mine,,,,\n"
    )
    if hooks:
        (own / "hooks.py").write_text(hooks)
    return own


def test_a_hook_of_a_folder_is_not_run_without_consent(tmp_path):
    own = folder(tmp_path, hook="strength", hooks="raise SystemExit('it ran')")
    with pytest.raises(ValueError, match=r"csv, line 2.*is a program: read it, and consent"):
        Drive(own)


def test_an_object_with_behaviour_comes_with_its_folder(tmp_path):
    own = folder(tmp_path, hook="strength")
    run_code(own)
    drive = Drive(own)
    drive.write("strength", 7)
    assert (drive.read("max_torque"), drive.read("strength")) == (700, 7)
    with pytest.raises(SdoAbort, match="device state"):
        drive.write("strength", 3)
    assert drive.read("max_torque") == 700
    drive.reset()
    assert Drive(drive.model).read("strength") == drive.read("strength")


def test_two_folders_have_hooks_of_one_name_each_its_own(tmp_path):
    ones = folder(tmp_path, hook="strength"), folder(
        tmp_path, hook="strength", hooks=HOOKS.replace("100", "50"), sub="second"
    )
    for own, unit in zip(ones, (100, 50), strict=True):
        run_code(own)
        drive = Drive(own)
        drive.write("strength", 2)
        assert drive.read("max_torque") == 2 * unit


@pytest.mark.parametrize(
    ("hook", "hooks", "says"),
    [
        ("strenth", HOOKS, "hook 'strenth' is unknown"),
        ("strength", "HOOKS = {'strength': print}", "has to be a servogym Hook"),
        ("strength", "1 / 0", "hooks.py fails .ZeroDivisionError"),
        ("strength", "", "fails .AttributeError"),
    ],
)
def test_what_is_no_hook_is_told_with_its_line(tmp_path, hook, hooks, says):
    own = folder(tmp_path, hook=hook, hooks=hooks or "x = 1")
    run_code(own)
    with pytest.raises(ValueError, match=rf"objects.csv, line 2.*{says}"):
        Drive(own)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Install a package as pip leaves it: a module, its metadata, an entry point for `strength`."""

    def package(name, text=HOOKS, value="HOOKS['strength']", attribute="strength"):
        place = tmp_path / "site-packages"
        about = place / f"{name}-1.0.dist-info"
        about.mkdir(parents=True)
        (place / f"{name}.py").write_text(f"{text}\nstrength = {value}\n")
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(
            f"[servogym.hooks]\nstrength = {name}:{attribute}\n"
        )
        monkeypatch.syspath_prepend(place)

    return package


def test_a_hook_of_an_installed_package_needs_no_consent(tmp_path, package):
    package("strong_hooks")
    drive = Drive(folder(tmp_path, hook="strength", hooks=""))
    drive.write("strength", 7)
    assert (drive.read("max_torque"), drive.read("strength")) == (700, 7)


def test_a_hook_of_the_folder_comes_before_that_of_a_package_and_still_needs_consent(
    tmp_path, package
):
    package("stronger_hooks")
    own = folder(tmp_path, hook="strength", hooks=HOOKS.replace("100", "50"))
    with pytest.raises(ValueError, match="is a program"):
        Drive(own)
    run_code(own)
    drive = Drive(own)
    drive.write("strength", 2)
    assert drive.read("max_torque") == 100


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"value": "print"}, "has to be a servogym Hook"),
        ({"text": "1 / 0"}, "fails .ZeroDivisionError"),
        ({"attribute": "strenth"}, "fails .AttributeError"),
    ],
)
def test_an_entry_point_that_gives_no_hook_is_told(tmp_path, package, wrong, says):
    name = f"wrong_hooks_{next(iter(wrong))}"
    package(name, **wrong)
    with pytest.raises(ValueError, match=rf"objects.csv, line 2.*entry point {name}:.*{says}"):
        Drive(folder(tmp_path, hook="strength", hooks=""))


@pytest.mark.parametrize("pdo", ["rx", "rxtx", "tx"])
def test_an_object_that_does_something_is_not_mapped_to_process_data(tmp_path, pdo):
    """A write hook would not run, and a PDO would carry the stored bytes, not what `read` gives."""
    own = folder(tmp_path, pdo=pdo, hook="strength")
    run_code(own)
    out = "tx" if pdo == "tx" else "rx"
    with pytest.raises(ValueError, match=rf"line 2.*code, which runs no hook: leave {out} out"):
        Drive(own)


REAL = ("-inf", "-8.5", "-1", "-0.0", "0", "0.25", "1", "1.0001", "7", "inf", "nan")
WHOLE = (
    -(1 << 63), -129, -128, -6, -5, -1, 0, 1, 2, 4, 6, 7, 127, 255, (1 << 63) - 1, (1 << 64) - 1,
)
RANGES = ((-5, 6), (-1, ""), (0, 7), (1, 4), ("", 2), ("", ""), ("{2;3;4;5}", ""))


def own_objects(tmp_path, rows):
    own = tmp_path / "own"
    own.mkdir()
    (own / "drive.toml").write_text('based_on = "generic"\n')
    (own / "objects.csv").write_text(HEAD + "".join(
        f"0x5000,{n:#04x},value_{n},RECORD,{row}\n" for n, row in enumerate(rows, 1)
    ))
    return Drive(own)


@pytest.mark.parametrize("data_type", [
    *(f"{kind}{bits}" for kind in ("INTEGER", "UNSIGNED") for bits in (8, 16, 32, 64)),
    "REAL32", "REAL64",
])
def test_the_range_of_an_object_of_ones_own_holds_by_sdo_and_by_pdo(tmp_path, data_type):
    """What SDO refuses leaves the object as it was by PDO, too; what SDO takes, PDO brings."""
    unsigned, bits = data_type.startswith("U"), int("".join(filter(str.isdigit, data_type)))
    low, high = (0, 1 << bits) if unsigned else (-(1 << bits - 1), 1 << bits - 1)
    numbers = [n for n in WHOLE if low <= n < high]
    if data_type.startswith("REAL"):
        numbers = [float(text) for text in REAL]
    ranges = RANGES[2:] if unsigned else RANGES
    drive = own_objects(tmp_path, [
        f"{data_type},rw,rxtx,,{least},{most},2,,mine,,,," for least, most in ranges
    ])
    refused = taken = 0
    for n, row in enumerate(ranges, 1):
        drive.map_pdos([[f"value_{n}"]])
        for number in numbers:
            drive.write(0x5000, n, 2)
            drive.latch(drive.pack(**{f"value_{n}": number}))
            by_pdo = drive.read(0x5000, n)
            drive.write(0x5000, n, 2)
            abort = drive.objects.write(0x5000, n, drive.objects.slots[0x5000, n].code.pack(number))
            assert repr(by_pdo) == repr(drive.read(0x5000, n)), (row, number)
            refused, taken = refused + bool(abort), taken + (not abort)
    assert refused > 3
    assert taken > 3


@pytest.mark.parametrize(("row", "why"), [
    ("UNSIGNED8,rw,rx,,{0;2;7},,0,,mine,,,,", "a set with gaps"),
    ("INTEGER16,rw,rxtx,,,,0,,mine,,,disabled,", "the state that `when` asks for"),
    ("UNSIGNED64,rw,rx,,1,,1,,mine,,,,", "no range that ends above"),
])
def test_a_rule_that_process_data_cannot_keep_is_refused_with_the_mapping(tmp_path, row, why):
    with pytest.raises(ValueError, match=rf"line 2.*compiled code, which .*{why}.*: leave rx out"):
        own_objects(tmp_path, [row])


def test_modes_of_the_maker_have_the_upper_bits_of_6502h():
    """CiA 402-2, 6502h: bits 16-31 are manufacturer-specific."""
    assert [mode_bit(mode) for mode in (-1, -3, -16)] == [16, 18, 31]
    assert [mode_bit(mode) for mode in Mode if mode > 0] == [mode - 1 for mode in Mode if mode > 0]


ALONE = """
import importlib.abc, pkgutil, sys

class Only(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {refused!r}:
            raise ImportError(name + " is not there")

sys.meta_path.insert(0, Only())
import servogym.drive
from servogym.drive import Drive
Drive().write("controlword", 6)
def skip(name):
    pass
for module in pkgutil.walk_packages(servogym.drive.__path__, "servogym.drive.", onerror=skip):
    try:
        __import__(module.name)
    except ImportError as error:
        assert "is not there" in str(error), error
        print(module.name.removeprefix("servogym.drive."))
"""
MAY_NEED_MORE = ("wire.", "canopen.eds", "canopen.decode", "canopen.replay")  # EDS: `canopen`


def test_the_drive_needs_numpy_and_numba_only():
    """No MuJoCo, no bus library, nothing of learning."""
    refused = [
        "mujoco", "gymnasium", "can", "canopen", "msgpack", "matplotlib", "PIL", "rich", "ruckig",
        "torch", "stable_baselines3", "nicegui", "scipy",
    ]
    done = subprocess.run(
        [sys.executable, "-c", ALONE.format(refused=refused)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert all(name.startswith(MAY_NEED_MORE) for name in done.stdout.split()), done.stdout
