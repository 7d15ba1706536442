"""Both axis benchmarks with cells of one's own: each option of the command line has its effect."""

import csv

import numpy as np
import pytest

from servogym.envs import linear_axis
from servogym.training import cli
from servogym.training.evaluate import positioning

STRATEGY = """
from servogym.training.policies.pd import Proportional

class Mine(Proportional):
    pass
"""
METHOD = """
def home(master):
    master.home(17)

home.reference = 17
"""


def rows(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def stored(path, **objects):
    """A file of parameters in which some objects are multiplied."""
    x = linear_axis().drives["x"]
    for name, factor in objects.items():
        x.write(name, round(x.read(name) * factor))
    path.write_bytes(x.parameters.export())
    return path


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def benchmark(here, words):
    assert cli.main(["benchmark", *words.split(), "--quick", "--out", "out"]) == 0
    kind = words.split()[0]
    page = (here / "out" / f"{kind}.md").read_text(encoding="utf-8")
    return rows(here / "out" / f"{kind}.csv"), page


def test_positioning_takes_axes_payloads_distances_strategies_and_parameters(here, monkeypatch):
    monkeypatch.setattr(positioning, "STRATEGIES", ("trapezoid",))
    (here / "mine.py").write_text(STRATEGY)
    soft = stored(here / "soft.json", position_control_gain=0.4)
    words = "positioning --mechanics rigid --payload 10 --distance 0.03 --policy mine.py:Mine"
    plain, _ = benchmark(here, words)
    softer, _ = benchmark(here, f"{words} --parameter-file {soft}")
    assert {row["mechanics"] for row in plain} == {"rigid"}
    assert {float(row["payload_kg"]) for row in plain} == {10.0}
    ways = {round(abs(float(row["goal_m"]) - float(row["start_m"])), 6) for row in plain}
    assert ways == {0.03}
    assert "mine.py:Mine" in {row["strategy"] for row in plain}

    def lag(found):
        return np.mean([float(r["peak_following_error_um"]) for r in found
                        if r["strategy"] == "trapezoid"])

    assert lag(softer) > 1.5 * lag(plain)


def test_positioning_has_state_feedback_where_a_sensor_sees_the_load(here, monkeypatch):
    rivals = ("jerk_limited", "ruckig+zvd", "lqr", "adaptive_lqr", "ruckig+ff", "learned")
    assert set(rivals) <= set(positioning.STRATEGIES)
    monkeypatch.setattr(positioning, "STRATEGIES", rivals)
    found, page = benchmark(
        here, "positioning --mechanics spring_load --payload 5 --distance 0.05 --drive generic"
    )
    strategies = {row["strategy"] for row in found}
    assert strategies == {*rivals}

    def mean(strategy, name):
        return np.mean([float(r[name]) for r in found if r["strategy"] == strategy])

    assert mean("lqr", "settling_s") < 0.5 < mean("jerk_limited", "settling_s")
    for row in found:  # a move after the other, by its definition
        duty = float(row["rms_torque_share_of_rated"]) ** 2 * 2.0 / float(row["settling_s"])
        assert float(row["i2t_duty"]) == pytest.approx(duty, rel=1e-3)
    assert "Repeated without a pause, it uses" in page


def test_homing_takes_drives_axes_a_payload_methods_runs_and_parameters(here):
    (here / "mine.py").write_text(METHOD)
    slow = stored(here / "slow.json", speed_during_search_for_switch=0.5)
    words = "homing --mechanics rigid --payload 20 --method 18 --runs 3 --policy mine.py:home"
    plain, page = benchmark(here, words)
    slower, _ = benchmark(here, f"{words} --parameter-file {slow}")
    assert {row["mechanics"] for row in plain} == {"rigid"}
    by_method = {m: [r for r in plain if r["method"] == m] for m in {r["method"] for r in plain}}
    assert {"17", "18", "mine.py:home"} <= by_method.keys()
    assert {len(found) for found in by_method.values()} == {3}
    assert all(row["attained"] == "1" for row in plain)
    assert "repeats best" in page

    def time(found, method):
        return np.mean([float(row["time_s"]) for row in found if row["method"] == method])

    assert time(slower, "17") > 1.5 * time(plain, "17")
    assert time(slower, "mine.py:home") > 1.5 * time(plain, "mine.py:home")
    assert time(plain, "mine.py:home") == pytest.approx(time(plain, "17"), abs=0.1)


@pytest.mark.parametrize(
    ("name", "said"),
    [("ruckg", "ruckg"), ("mine.py:gone", "there is no Python file"), ("lqr", "lqr")],
)
def test_a_strategy_that_can_move_no_axis_is_refused_not_left_out(here, capsys, name, said):
    words = f"benchmark positioning --mechanics rigid --payload 5 --quick --policy {name}"
    assert cli.main(words.split()) == 2
    assert said in " ".join(capsys.readouterr().err.split())


BAD = """
class Policy:
    def __init__(self, datasheet, seed):
        pass

def two(master, other):
    master.home(17)

def lost(master):
    pass

def raises(master):
    raise KeyError("gain")

def leaves(master):
    raise SystemExit(0)

def forever(master):
    while True:
        master.port.exchange()

def astray(master):
    master.home(17)

astray.reference = 35
"""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Policy", "it is a class; a homing method is a function"),
        ("two", "missing a required argument: 'other'"),
        ("raises", "--policy bad.py:raises fails: "),
        ("leaves", "in leaves: SystemExit: 0"),
        ("astray", "reference = 35: give the method whose home it should find"),
    ],
)
def test_what_is_no_homing_method_is_refused_by_its_first_run(here, capsys, name, said):
    (here / "bad.py").write_text(BAD)
    assert cli.main(["benchmark", "homing", "--quick", "--policy", f"bad.py:{name}"]) == 2
    assert said in " ".join(capsys.readouterr().err.split())


def test_a_method_that_does_not_home_is_named_with_its_reason_and_claims_nothing(here, capsys):
    (here / "bad.py").write_text(BAD)
    own = "bad.py:lost,bad.py:forever"
    _, page = benchmark(here, f"homing --mechanics rigid --runs 2 --policy {own}")
    shown = " ".join(capsys.readouterr().out.split())
    for name, why in (("lost", "it ended without"), ("forever", "home within 120 s of the axis's")):
        said = f"Method bad.py:{name} on rigid does not home in 2 of 2 runs: {why}"
        assert said in page
        assert said in shown
    assert "(– to –)" not in page
    assert "With method" not in page


@pytest.mark.slow
def test_homing_takes_a_drive(here):
    found, page = benchmark(here, "homing --mechanics rigid --runs 2 --drive kollmorgen_akd")
    assert "drive kollmorgen_akd" in page
    assert all(row["attained"] == "1" for row in found)
