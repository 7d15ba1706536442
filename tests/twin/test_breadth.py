"""Logs of each drive model, on each bus, in each mode of positioning, against hidden parameters.

The normal suite replays a log into the machine that made it; the slow one makes twins of all. The
oracle is the machine, the master is another program path than the reader: objects by SDO and PDO.
"""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import buses
from buses import CELLS, HIDDEN, cell, record
from campaign import NAMES, READ, stream
from campaign import row as machine_of
from machines import Node, hide, moves

from servogym.drive.model.model import load
from servogym.drive.wire.recording import Signal, Source
from servogym.envs import linear_axis
from servogym.envs.engine import parameters
from servogym.envs.engine.replay import Replay
from servogym.envs.panel.session import Session
from servogym.envs.plants.catalogue import fresh
from servogym.envs.twin import logs
from servogym.envs.twin.candidates import LAG, Candidates
from servogym.envs.twin.estimate import FreeParameter, Search
from servogym.envs.twin.experiment import experiment
from servogym.envs.twin.families import FAMILIES
from servogym.envs.twin.fit import best_lag, fit
from servogym.envs.twin.reconstruction import expected, restored, timed
from servogym.training.cli import main

EACH = [(model, bus, mode) for model, bus, modes in CELLS for mode in modes]
SAMPLE = [("generic", "can", "pp"), ("kollmorgen_akd", "ethercat", "pp"),
          ("festo_cmmp_as", "can", "ip")]
NOISE = 0.5e-6  # m, of the encoder
RIGID = FAMILIES["rigid"]


def left_over(found, model, hidden):
    """Rms (m) of what the machine with the hidden parameters leaves of its own log."""
    candidates = Candidates(lambda: RIGID.make(model), "x", 4)
    values = hidden | {LAG: 0.0}
    values[LAG] = best_lag(candidates, found, values)
    for _ in range(2):
        found = timed(candidates, found, values)
        search = Search(candidates, [found], hidden)
        lag = FreeParameter(LAG, values[LAG], -0.02, 0.2, 2e-5)
        values = search.descend([lag], values, search.start_noise(), 4).values
    run = candidates.simulate(found, [values])
    moving = found.moving
    return float(np.sqrt(np.mean((found.position - run.position[0])[moving] ** 2)))


@pytest.mark.parametrize(("model", "bus", "mode"), SAMPLE)
def test_a_log_comes_back_out_of_the_machine_that_made_it(model, bus, mode, tmp_path):
    rng = np.random.default_rng(4)
    machine = linear_axis(load(model, bus))
    hidden = hide(machine, rng, HIDDEN)
    log = tmp_path / ("a.log" if bus == "can" else "a.pcapng")
    record(machine, log, rng, mode, 1e-3, fieldbus=bus, noise=NOISE, seconds=1.0)
    (found,) = logs.read([log], RIGID.make(model), model, "x")
    assert left_over(found, model, hidden) < 4 * NOISE


def without_torque(patch):
    patch.setattr(buses, "INPUTS", ("statusword", "position_actual_value"))


def with_a_gap(patch):
    stamp = buses.Logged.stamp
    patch.setattr(buses.Logged, "stamp", lambda log, now, often=True: (
        None if log.cyclic and 1.0 < now < 2.2 else stamp(log, now, often)))


def of_a_still_axis(patch):
    patch.setattr(buses, "moves", lambda rng, seconds, period, low, high: np.full(
        round(seconds / period), 0.5 * (low + high)))


def of_an_akd(folder):
    """Moves of an AKD on EtherCAT, captured at the master's interface; -> the words of a twin."""
    log = record(linear_axis(load("kollmorgen_akd", "ethercat")), folder / "a.pcapng",
                 np.random.default_rng(1), "csp", 1e-3, fieldbus="ethercat", seconds=2.5)
    return ["twin", str(log), "--mechanics", "rigid", "-o", str(folder / "twin"), "--drive"]


@pytest.mark.parametrize(
    ("change", "said"),
    [(without_torque, "no torque"), (with_a_gap, "recorded"), (of_a_still_axis, "does not move")],
)
def test_what_is_wrong_with_an_ethercat_log_is_one_line(change, said, tmp_path, monkeypatch,
                                                        capsys):
    change(monkeypatch)
    out = tmp_path / "twin"
    assert main([*of_an_akd(tmp_path), "kollmorgen_akd"]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert said in error
    assert re.search("record|map|say|give|--", error), error
    assert not (out / "twin.json").exists()


@pytest.mark.slow
def test_an_ethercat_log_of_another_drive_ends_with_a_verdict(tmp_path, capsys):
    assert main([*of_an_akd(tmp_path), "festo_cmmp_as"]) == 1
    said = capsys.readouterr().out
    assert "refused: do not trust it" in said
    assert "the drive model" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "bus", "mode", "period"),
    [(*each, period) for each in EACH for period in (1e-3, 1e-2)],
)
def test_a_twin_comes_out_of_each_log(model, bus, mode, period, tmp_path):
    twin, hidden, *_ = cell(model, bus, mode, period, 1, tmp_path)
    assert twin.ratio < 2.0
    assert twin.values["payload"] == pytest.approx(hidden["payload"], rel=0.05)


@pytest.fixture(scope="module")
def moves_in_pp(tmp_path_factory):
    """Signals of moves in profile position, nothing lost, and the machine's parameters."""
    rng = np.random.default_rng(4)
    machine = linear_axis()
    hidden = hide(machine, rng, HIDDEN)
    log = tmp_path_factory.mktemp("pp") / "a.log"
    record(machine, log, rng, "pp", 1e-3, noise=NOISE, seconds=2.5, dropped=0.0, jitter=0.0)
    return Source(log, "generic").signals("1"), hidden


def test_a_set_point_is_moved_to_the_cycle_that_the_axis_shows(moves_in_pp):
    """Stamps of set-points that are off by a cycle or two, as those of a USB adapter."""
    signals, hidden = moves_in_pp
    rng = np.random.default_rng(2)
    word = signals["controlword"]
    late = Signal(word.time + rng.uniform(-6e-4, 6e-4, len(word.time)), word.value, word.unit)
    found = experiment(signals | {"controlword": late}, RIGID.make("generic"), "x")
    candidates = Candidates(lambda: RIGID.make("generic"), "x", 4)
    values = hidden | {LAG: best_lag(candidates, found, hidden | {LAG: 0.0})}

    def error(found):
        run = candidates.simulate(found, [values])
        return float(np.sqrt(np.mean((found.position - run.position[0])[found.moving] ** 2)))

    left = left_over(found, "generic", hidden)
    assert error(found) > 10 * left
    assert left < 4 * NOISE


@pytest.fixture(scope="module")
def coarse_pp(tmp_path_factory):
    """A log in profile position with a sample every 10 ms, and a fit's candidates and truth."""
    rng = np.random.default_rng(1)
    machine = linear_axis(load("festo_cmms", "can"))
    hidden = hide(machine, rng, HIDDEN)
    log = record(machine, tmp_path_factory.mktemp("pp10") / "a.log", rng, "pp", 1e-2, noise=NOISE,
                 seconds=3.0)
    (found,) = logs.read([log], RIGID.make("festo_cmms"), "festo_cmms", "x")
    candidates = Candidates(lambda: RIGID.make("festo_cmms"), "x")
    values = hidden | {LAG: best_lag(candidates, found, hidden | {LAG: 0.0})}
    return timed(candidates, found, values), candidates, values


def rms(experiment, candidates, values):
    """What a machine leaves of a log's position while the axis moves (m), with its best lag."""
    fixed = {name: value for name, value in values.items() if name != LAG}
    search = Search(candidates, [experiment], fixed)
    lag = FreeParameter(LAG, values[LAG], -0.02, 0.2, 2e-5)
    values = search.descend([lag], values, search.start_noise(), 4).values
    run = candidates.simulate(experiment, [values])
    left = experiment.residuals(run.position[0], run.torque[0])[experiment.moving, 0]
    return float(np.sqrt(np.mean(left**2)))


def test_encoder_noise_moves_the_expected_path_of_an_axis_with_friction(coarse_pp):
    """The oracle is a log of another program path, with noise of its own."""
    found, candidates, values = coarse_pp
    replicated = expected(candidates, expected(candidates, found, values), values)
    assert replicated.replicas.deviation == pytest.approx(NOISE, rel=0.3)
    assert rms(replicated, candidates, values) < 0.75 * rms(found, candidates, values)


def test_a_wrong_model_cannot_pass_its_errors_off_as_noise(coarse_pp):
    found, candidates, values = coarse_pp
    wrong = values | {"coulomb_friction": 3 * values["coulomb_friction"], "payload": 20.0}
    replicated = expected(candidates, expected(candidates, found, wrong), wrong)
    assert rms(found, candidates, wrong) > 20 * NOISE
    assert replicated.replicas.deviation < 3 * NOISE


def late(machine, rng, every, seconds=4.0, period=1e-3):
    """The signals of a master that is late now and then; the drive gets set-points when they come.

    Each frame comes 0.2 ms late on average, 0.5 % of them 1 to 8 ms; samples are seen `every` few
    cycles. The stamps are right to 50 µs.
    """
    parameters.apply(machine, {"encoder_noise": NOISE})
    places = moves(rng, seconds, period)
    drive, lead = machine.drives["x"], 300
    gear = machine.joint("x")[0]
    unit = float(drive.axis.rad_per_position_unit) / gear
    machine.reset({"x": float(places[0])})
    machine.step()
    wanted = round(float(places[0]) * gear / float(drive.axis.rad_per_increment))
    drive.axis.zero_counts, drive.axis.homed = int(drive.axis.counts) - wanted, 1
    drive.commission({"interpolation_time_index": -3, "interpolation_time_period_value": 1,
                      "following_error_window": 2**31 - 1})
    units = np.round(np.concatenate([np.full(lead, places[0]), places]) / unit)
    held_up = rng.exponential(2e-4, len(units))
    held_up += (rng.random(len(units)) < 0.005) * rng.uniform(1e-3, 8e-3, len(units))
    held_up[:lead] = 0.0
    comes = np.maximum.accumulate(np.arange(len(units)) * period + held_up)
    per = round(period / machine.cycle_time)
    layout = Replay("x", ["controlword", "modes_of_operation", "target_position"], READ)
    rows = np.zeros(per * len(units), layout.written)
    at = np.ceil(comes / machine.cycle_time - 1e-9).astype(int)
    last = np.searchsorted(at, np.arange(len(rows)), "right") - 1
    rows["target_position"] = units[np.clip(last, 0, None)]
    rows["controlword"], rows["modes_of_operation"] = 15, 8
    rows["controlword"][: 10 * per], rows["controlword"][10 * per : 20 * per] = 6, 7
    arrives = np.zeros(len(rows), bool)
    arrives[at[at < len(rows)]] = True
    run = layout.run([machine], rows, arrives)[0][lead * per :][per * every - 1 :: per * every]
    stamps = comes[lead:] - lead * period + rng.uniform(0, 5e-5, len(places))
    time = np.arange(1, len(run) + 1) * every * period + rng.uniform(0, 5e-5, len(run))
    return {"target_position": Signal(stamps, units[lead:], "")} | {
        name: Signal(time, run[column].astype(float), "")
        for column, name in zip(READ, NAMES, strict=True)}


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 5])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_twin_of_late_set_points_is_refused_and_says_what_to_record(seed, every):
    machine = RIGID.make("generic")
    rng = np.random.default_rng(seed)
    hidden = hide(machine, rng, HIDDEN)
    found = experiment(late(machine, rng, every), RIGID.make("generic"), "x")
    assert any("irregularly" in note and "record" in note for note in found.notes)
    twin = fit([found], "generic", RIGID, gains_known=True)
    assert twin.verdict == "refused"
    for name, true in hidden.items():
        low, high = twin.estimate.interval(name)
        assert low <= true <= high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("series", "seed"),
    [("load on a spring", 1207), ("load on a spring", 1214), ("vertical", 1424)],
)
def test_a_search_follows_the_valley_in_which_an_axis_moves_alike(series, seed):
    row = machine_of(series, seed)
    assert row["verdict"] == "good"
    payload = row["parameters"]["payload"]
    assert payload["found"] == pytest.approx(payload["true"], rel=0.05)


@pytest.mark.slow
def test_a_model_that_does_not_repeat_what_it_was_fitted_to_is_refused():
    """The held-out part of this log is so quiet that a rigid axis explains it; the rest is not."""
    row = machine_of("a spring as rigid", 1318)
    assert row["held_out"] < 2 * row["floor"]
    assert row["verdict"] == "refused"


def test_moves_whose_ramps_are_not_in_the_log_are_a_note(moves_in_pp):
    signals, _ = moves_in_pp
    bare = {name: s for name, s in signals.items() if not name.startswith("profile_")}
    found = experiment(bare, RIGID.make("generic"), "x")
    assert any("profile_acceleration" in note and "--read-gains" in note for note in found.notes)
    assert not experiment(signals, RIGID.make("generic"), "x").notes


def test_profiles_that_change_between_moves_are_those_of_each_move(moves_in_pp):
    signals, _ = moves_in_pp
    found = experiment(signals, RIGID.make("generic"), "x")
    begins = found.events.at[found.events.begins]
    speeds = found.rows["profile_velocity"][begins]
    assert len(set(speeds)) == len(begins) > 2
    later = found.moved(np.arange(len(begins)))
    assert (later.events.at[later.events.begins] - begins).tolist() == [*range(len(begins))]
    assert replace(found, events=None).known < found.known


@pytest.mark.parametrize("period", [1e-3, 1e-2])
def test_set_points_lost_from_a_log_are_found_again(period):
    """The oracle is what was sent; the set-points are those of a table, with a coarse unit."""
    table = FAMILIES["rotary_table"]
    rng = np.random.default_rng(7)
    machine = table.make("generic")
    parameters.apply(machine, {"encoder_noise": NOISE})
    signals = stream(machine, "x", moves(rng, 2.0, period), period, rng, dropped=0.0, jitter=0.0)
    sent = signals["target_position"]
    turning = np.flatnonzero(np.abs(np.diff(sent.value, 2)) > 1) + 1
    lost = turning[turning > 0.3 / period][:: max(len(turning) // 8, 1)]
    keep = np.setdiff1d(np.arange(len(sent.value)), lost)
    signals["target_position"] = Signal(sent.time[keep], sent.value[keep], sent.unit)
    found = experiment(signals, table.make("generic"), "x")
    assert len(found.missed.at) == len(lost) > 3
    candidates = Candidates(lambda: table.make("generic"), "x", 2)
    values = parameters.get(machine, table.unknown)
    values[LAG] = best_lag(candidates, found, values)
    again = restored(candidates, found, values, Search(candidates, [found]).noise(values))

    def off(experiment):
        return np.abs(experiment.rows["target_position"][found.missed.at] - sent.value[lost])

    assert off(found).max() >= 1
    assert np.mean(off(again)) < 0.35 * np.mean(off(found))


def test_of_a_deployment_the_parts_of_the_task_are_taken(tmp_path):
    """Episodes in csp, each after a way to its start in pp; between them the drive is off."""
    rng = np.random.default_rng(4)
    machine = linear_axis()
    hidden = hide(machine, rng, HIDDEN)
    parameters.apply(machine, {"encoder_noise": NOISE})
    machine.reset({"x": 0.1})
    node = Node(machine, tmp_path / "run.log", rng)
    node.configure()
    axis = machine.drives["x"].axis
    axis.zero_counts = int(axis.counts) - round(
        0.1 * machine.joint("x")[0] / float(axis.rad_per_increment))
    axis.homed = 1
    node.turn()
    for index, value in ((2, -3), (1, 1)):
        node.download(0x60C2, index, value, 1)
    for index, value in ((0x6081, 500_000), (0x6083, 5_000_000), (0x6084, 5_000_000)):
        node.download(index, 0, value, 4)
    for low in (0.1, 0.2):
        node.enable(1)
        for word in (0x0F, 0x1F):
            for _ in range(500):
                node.command(word, 1, round(1e6 * (low + 0.1)))
        for place in moves(rng, 1.0, 1e-3, low=low, high=low + 0.2):
            node.command(0x0F, 8, round(1e6 * place))
        for _ in range(300):
            node.command(0x06, 8, 0)
    parts = logs.read([node.close()], RIGID.make("generic"), "generic", "x")
    assert [part.mode for part in parts] == [8, 8]
    assert all(0.9 < part.duration < 1.01 for part in parts)
    assert left_over(parts[1], "generic", hidden) < 4 * NOISE


def test_the_table_of_the_panels_scope_is_a_log(tmp_path):
    """In the units that the panel shows: mm, and percent of the rated torque."""
    session = Session(fresh("linear"), "linear")
    session.scope.choose(["controlword", "statusword", "target_position", "position_actual_value",
                          "torque_actual_value", "modes_of_operation_display"])
    session.scope.set_window(3.0, 0.25)
    assert session.enable("x") == ""
    assert session.home("x", 17) == ""
    session.advance(0.3)
    for place in (0.1, 0.3, 0.15, 0.35):
        assert session.move("x", place) == ""
        session.advance(0.1)
    shown = {"target_position": (1e-3, "mm"), "position_actual_value": (1e-3, "mm"),
             "torque_actual_value": (0.1, "% rated")}
    table = tmp_path / "scope.csv"
    table.write_text(session.scope.csv(shown))
    (found,) = logs.read([table], RIGID.make("generic"), "generic", "x")
    assert found.mode == 1
    assert np.ptp(found.position) > 0.15
    own = parameters.get(session.machine, HIDDEN)
    assert left_over(found, "generic", own) < 2e-6
