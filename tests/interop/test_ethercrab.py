"""ethercrab 0.7.1 against `servogym ethercat`; built from source, so not part of `make test`.

``pytest -m slow tests/interop/test_ethercrab.py`` builds it with cargo, which takes a minute of
processor time; ``SERVOGYM_ETHERCRAB`` names a program that is built already.
"""

import os
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import pytest
from wire import on_the_wire

FOLDER = Path(__file__).parent / "ethercrab"
CYCLES = 10_000


@pytest.fixture(scope="module")
def program():
    if built := os.environ.get("SERVOGYM_ETHERCRAB"):
        return built
    if not shutil.which("cargo"):
        pytest.skip("cargo is not there")
    build = ["nice", "-n", "19", "cargo", "build", "--release", "-j1", "--quiet"]
    subprocess.run(build, cwd=FOLDER, check=True, timeout=900)
    return str(FOLDER / "target/release/reach-op")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "name", "device", "sizes"),
    [
        ("kollmorgen_akd", "AKD EtherCAT Drive (CoE)", "AKD-P00606-NBCC-E000", [6, 6]),
        ("generic", "Generic CiA 402 drive", "servogym generic CiA 402 drive", [7, 7]),
    ],
)
def test_31_ethercrab_scans_and_reaches_op_and_every_working_counter_is_right(
    program, model, name, device, sizes
):
    options = ("--drive", model, "--axis", "none", "--slaves", "2")
    result = on_the_wire("ethercrab_master", "reach_op", *options, program=program, cycles=CYCLES)
    assert [slave["device"] for slave in result["slaves"]] == [device] * 2
    assert {slave["name"] for slave in result["slaves"]} <= {
        name,
        name.split()[0],
        "AKD",
        "generic",
    }
    if model == "kollmorgen_akd":
        for slave in result["slaves"]:
            assert (slave["vendor"], slave["product"], slave["revision"]) == (0x6A, 0x414B44, 2)
    assert result["sizes"] == [sizes, sizes]
    assert (result["cycles"], result["wrong"], result["wkc"]) == (CYCLES, 0, 6)


@pytest.mark.slow
@pytest.mark.parametrize("clock", ["frame", "dc", "real"])
def test_ethercrab_with_sync0_stays_in_op_on_every_clock(program, clock):
    """Each cycle is one period of DC time: on the clock frame exactly, else by the median.

    On the clock real a master that is late loses a drive, as it should: then it tries again.
    """
    options = ("--drive", "generic", "--axis", "none", "--slaves", "2", "--clock", clock)
    result = on_the_wire(
        "ethercrab_master", "reach_op", *options, program=program, cycles=300, period=10,
        in_time=lambda result: clock != "real" or not result["wrong"],
    )
    assert (result["cycles"], result["wrong"], result["wkc"]) == (300, 0, 6)
    passed = sorted((b - a) / 1e6 for a, b in pairwise(result["times"]))
    if clock == "frame":
        assert (passed[0], passed[-1]) == (10.0, 10.0)
    assert passed[len(passed) // 2] == pytest.approx(10.0, abs=2.0)


@pytest.mark.slow
@pytest.mark.parametrize("clock", ["dc", "real"])
def test_ethercrab_without_sync0_on_the_clocks_of_the_wall(program, clock):
    options = ("--drive", "generic", "--axis", "none", "--slaves", "2", "--clock", clock)
    result = on_the_wire("ethercrab_master", "reach_op", *options, program=program, cycles=CYCLES)
    assert (result["cycles"], result["wrong"], result["wkc"]) == (CYCLES, 0, 6)


@pytest.mark.slow
def test_35_ethercrab_finds_the_delays_of_a_line_of_eight(program):
    options = ("--drive", "kollmorgen_akd", "--axis", "none", "--slaves", "8")
    result = on_the_wire("ethercrab_master", "reach_op", *options, program=program, cycles=100)
    assert [slave["delay"] for slave in result["slaves"]] == [600 * k for k in range(8)]
    assert (result["wrong"], result["wkc"]) == (0, 24)
