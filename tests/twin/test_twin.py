"""A log of a node's bus becomes a machine; the hidden parameters are the oracle."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import health
import machines as made

from servogym.drive.wire.recording import Signal, Source
from servogym.envs import linear_axis
from servogym.envs.engine import parameters
from servogym.envs.plants import twins
from servogym.envs.plants.catalogue import of_twin
from servogym.envs.twin import logs
from servogym.envs.twin.estimate import Noise, Search, colour
from servogym.envs.twin.experiment import Experiment, Unusable, experiment
from servogym.envs.twin.families import FAMILIES
from servogym.envs.twin.fit import fit, refuse
from servogym.envs.twin.folder import content, save
from servogym.envs.twin.health import Change, changes
from servogym.envs.twin.plan import KINDS, Limits, plan
from servogym.envs.twin.regression import regress
from servogym.envs.twin.words import doubts, missing
from servogym.training.cli import main
from servogym.training.cli.twin import GAIN_OBJECTS

HIDDEN = ("payload", "coulomb_friction", "viscous_friction")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A machine nobody knows, and the candump log of its moves; 0.5 % of the frames are missing."""
    rng = np.random.default_rng(3)
    machine = linear_axis()
    hidden = made.hide(machine, rng, HIDDEN)
    file = tmp_path_factory.mktemp("bus") / "moves.log"
    return made.csp_log(machine, file, rng, dropped=0.005, jitter=2e-4, seconds=3.0), hidden


@pytest.fixture(scope="module")
def fitted(recorded):
    log, _ = recorded
    rigid = FAMILIES["rigid"]
    (found,) = logs.read([log], rigid.make("generic"), "generic", "x")
    return fit([found], "generic", rigid, gains_known=True)


@pytest.fixture(scope="module")
def folder(fitted, recorded, tmp_path_factory):
    where = tmp_path_factory.mktemp("twin")
    save(where, fitted, "generic", [recorded[0]], [fitted])
    return where


def test_hidden_parameters_come_out_of_a_can_log(fitted, recorded):
    _, hidden = recorded
    assert fitted.values["payload"] == pytest.approx(hidden["payload"], rel=0.02)
    assert fitted.values["coulomb_friction"] == pytest.approx(hidden["coulomb_friction"], rel=0.08)
    assert fitted.values["viscous_friction"] == pytest.approx(hidden["viscous_friction"], rel=0.15)


def test_a_right_family_is_believed(fitted):
    assert fitted.verdict == "good"
    assert fitted.held_position < 1.3 * fitted.floor_position < 2e-6


def test_a_twin_is_that_machine(folder, recorded, fitted):
    machine = linear_axis(twin=folder)
    found = parameters.get(machine, HIDDEN)
    for name in HIDDEN:
        assert found[name] == pytest.approx(fitted.values[name], rel=1e-4)
    assert machine.drives["x"].model.name == "generic"


def test_an_environment_is_made_of_a_twin_and_draws_from_its_intervals(folder):
    env = gym.make("servogym.envs:servogym/LinearAxis-v0", twin=folder, randomise="twin").unwrapped
    env.reset(seed=1)
    twin = twins.read(folder)
    row = twin.parameters["coulomb_friction"]
    assert row.low <= env.parameters["coulomb_friction"] <= row.high
    assert set(HIDDEN) <= set(env.parameters)
    assert env.datasheet.payload == pytest.approx(twin.values["payload"])
    env.close()


@pytest.mark.parametrize(
    ("task", "more", "said"),
    [
        ("LinearAxis", {"drive": "kollmorgen_akd"}, "leave it out"),
        ("RotaryAxis", {}, "not the machine"),
    ],
)
def test_a_twin_goes_into_its_own_kind_of_task_alone(folder, task, more, said):
    with pytest.raises(ValueError, match=said):
        gym.make(f"servogym.envs:servogym/{task}-v0", twin=folder, **more)


def test_drawing_from_a_twin_needs_one():
    with pytest.raises(ValueError, match="needs a twin"):
        gym.make("servogym.envs:servogym/LinearAxis-v0", randomise="twin")


def test_the_same_log_gives_the_same_bytes(fitted, recorded, folder, tmp_path):
    rigid = FAMILIES["rigid"]
    (found,) = logs.read([recorded[0]], rigid.make("generic"), "generic", "x")
    again = fit([found], "generic", rigid, gains_known=True)
    save(tmp_path, again, "generic", [recorded[0]], [again])
    assert (tmp_path / "twin.json").read_bytes() == (folder / "twin.json").read_bytes()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c["parameters"]["payload"].update(value=99.0), "checksum"),
        (lambda c: c.update(schema="servogym.twin/9"), "schema"),
        (lambda c: c.pop("schema"), "damaged"),
    ],
)
def test_a_folder_that_was_changed_is_refused(folder, tmp_path, change, said):
    content = json.loads((folder / "twin.json").read_text())
    change(content)
    (tmp_path / "twin.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=said):
        twins.read(tmp_path)


def test_a_name_that_is_no_parameter_is_refused(folder, tmp_path):
    content = json.loads((folder / "twin.json").read_text())
    content["parameters"]["__import__"] = content["parameters"].pop("payload")
    content["checksum"] = twins.checksum(content)
    (tmp_path / "twin.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match="__import__"):
        twins.read(tmp_path)


def test_a_folder_without_a_twin_says_how_one_is_made(tmp_path):
    with pytest.raises(ValueError, match="servogym twin"):
        linear_axis(twin=tmp_path)


def test_health_finds_nothing_in_the_same_machine(fitted, folder):
    found = {change.name: change for change in changes(twins.read(folder), fitted)}
    assert not any(change.certain for change in found.values())
    assert abs(found["payload"].change) < 1e-3
    assert "no change is certain" in str(found["coulomb_friction"])


def test_health_finds_friction_that_has_grown(folder, recorded, tmp_path, capsys):
    _, hidden = recorded
    worn = linear_axis()
    parameters.apply(worn, hidden | {"coulomb_friction": 1.18 * hidden["coulomb_friction"]})
    log = made.csp_log(worn, tmp_path / "new.log", np.random.default_rng(8), dropped=0.005,
                       jitter=2e-4, seconds=3.0)
    assert main(["twin", "--against", str(folder), str(log), "-o", str(tmp_path / "health")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("coulomb friction +")
    found = {c["name"]: c for c in json.loads((tmp_path / "health/health.json").read_text())[
        "changes"]}
    assert found["coulomb_friction"]["certain"]
    assert found["coulomb_friction"]["low"] < 18.0 < found["coulomb_friction"]["high"]
    assert not found["payload"]["certain"]


def test_an_alarm_is_twice_as_far_away_as_an_interval_reaches():
    """Of 70 parameters in ten healthy logs 95 % intervals alone would give three or four."""
    assert not Change("payload", 5.0, 5.1, 2.0, 0.5, 3.5, "%").certain
    assert not Change("load_force", 0.0, -1.0, -1.0, -1.9, -0.1, "N").certain
    assert Change("payload", 5.0, 5.1, 2.0, 1.1, 2.9, "%").certain
    assert Change("load_force", 0.0, -1.0, -1.0, -1.4, -0.6, "N").certain


def test_what_the_old_twin_has_not_determined_is_no_alarm():
    change = Change("backlash", 2e-5, 3e-5, 1e-5, 0.9e-5, 1.1e-5, "m", known=False)
    assert not change.certain
    assert "--free backlash" in str(change)
    assert replace(change, known=True).certain


@pytest.mark.parametrize("name", ["spindle", "spring", "rotary_table"])
def test_a_new_log_is_fitted_as_the_family_of_its_twin(name, fitted, recorded, tmp_path,
                                                       monkeypatch):
    """Some families differ in what is unknown alone; and what was found of the drive is known."""
    family, asked = FAMILIES[name], {}
    found = content(fitted, "generic")
    arguments = dict(family.arguments)
    found |= {"mechanics": name, "machine": {"builder": family.builder, "arguments": arguments,
                                             "axis": family.axis}, "objects": {"max_torque": 2500}}
    gain = {"value": 10.0, "low": 10.0, "high": 10.0, "unit": "Nm/rad"}
    found["parameters"] = {"pid_gain": gain}
    found["checksum"] = twins.checksum(json.loads(json.dumps(found)))
    (tmp_path / "twin.json").write_text(json.dumps(found))

    def choose(experiments, drive, names, built, objects, **more):
        asked.update(names=names, objects=objects, **more)
        raise ValueError("asked")

    monkeypatch.setattr("servogym.envs.twin.fit.choose", choose)
    monkeypatch.setattr(logs, "read", lambda *arguments, **more: [])
    assert main(["twin", "--against", str(tmp_path), str(recorded[0])]) == 2
    assert asked["names"] == [name]
    assert asked["objects"]["max_torque"] == 2500
    assert asked["objects"]["pid_gain"] == pytest.approx(1e7)
    assert asked["free"] == (("backlash",) if name == "rotary_table" else ())


@pytest.mark.slow
def test_healthy_logs_give_no_alarm_and_changed_ones_do(capsys):
    """New moves of two machines, with their own noise, jitter and losses, by `twin --against`."""
    for mechanics, name, change, count in health.CHANGES:
        for seed in range(1600, 1600 + count):
            row = health.play(mechanics, change, seed)
            told = {n for n, each in row["changes"].items() if each["certain"]}
            assert told == set(change), (name, seed, row)
            for n, true in row["true"].items():
                each = row["changes"][n]
                per = 100 / each["before"] if each["unit"] == "%" else 1.0
                assert each["low"] <= per * true <= each["high"], (name, seed, row)


def test_the_machine_of_a_folder_comes_out_of_one_function(folder):
    machine = of_twin(folder)
    assert parameters.get(machine, ["payload"])["payload"] == pytest.approx(
        twins.read(folder).values["payload"]
    )


def tied(fitted, first, second):
    """The same fit, had its log told two parameters apart badly."""
    names = [free.name for free in fitted.estimate.free]
    i, k = names.index(first), names.index(second)
    covariance = fitted.estimate.covariance.copy()
    covariance[i, i] = covariance[k, k] = 100.0
    covariance[i, k] = covariance[k, i] = -99.5
    return replace(fitted, estimate=replace(fitted.estimate, covariance=covariance))


def test_a_log_says_what_it_cannot_tell_apart_and_which_move_would(fitted):
    assert missing(fitted) == ()
    blind = tied(fitted, "coulomb_friction", "viscous_friction")
    assert any("hard to separate" in text and "third of the speed" in text
               for text in doubts(blind))
    assert missing(blind)[0] == "speed"


@pytest.mark.parametrize("kind", KINDS)
def test_what_tells_a_parameter_stays_within_the_limits(kind):
    limits = Limits(0.1, 0.4, 0.5, 5.0, 200.0)
    found = plan(limits, 1e-3, kinds=[kind])
    assert len(found) > 300
    assert np.ptp(found) > 1e-3
    assert 0.1 <= found.min() < found.max() <= 0.4
    assert abs(np.diff(found)).max() * 1e3 <= 0.5 * 1.01
    assert abs(np.diff(found, 2)).max() * 1e6 <= 5.0 * 1.1


# ------------------------------------------------------------------- bad input


def streams(log, **other):
    source = Source(Path(log), "generic")
    signals = source.signals("1")
    for name, change in other.items():
        signals[name] = change(signals[name]) if change else signals.pop(name) and None
    return {name: signal for name, signal in signals.items() if signal is not None}


def usable(found):
    """What a fit asks of an experiment before it begins."""
    joint = parameters.Joint(FAMILIES["rigid"].make("generic"), "x")
    refuse([found], regress([found], joint.gear), joint, FAMILIES["rigid"])


def still(s):
    return Signal(s.time, np.full(len(s.value), s.value[0]), s.unit)


BAD = {
    "motion": ({"position_actual_value": still}, "does not move"),
    "torque": ({"torque_actual_value": None}, "no torque"),
    "changing torque": ({"torque_actual_value": still}, "torque does not change"),
    "position": ({"position_actual_value": None}, "no position"),
    "set-points": ({"target_position": None}, "no set-points"),
    "enabled": ({"statusword": lambda s: Signal(s.time, 0 * s.value + 0x21, s.unit)}, "enabled"),
    "a gap": (
        {"position_actual_value": lambda s: Signal(
            s.time[cut], s.value[cut], s.unit) if (cut := abs(s.time - 1.5) > 0.4) is not None
            else s},
        "nothing was recorded",
    ),
}


@pytest.mark.parametrize(("other", "said"), BAD.values(), ids=BAD)
def test_a_log_that_lacks_something_says_what_and_how_to_record_it(recorded, other, said):
    with pytest.raises(Unusable, match=said) as error:
        experiment(streams(recorded[0], **other), linear_axis(), "x")
    assert "record" in str(error.value) or "map" in str(error.value)


def other(change):
    return lambda s: Signal(s.time, change(s.value), s.unit)


def noise(values):
    return np.round(np.random.default_rng(1).normal(0, 100, len(values)))


BOTH = "position_actual_value", "target_position"
UNFIT = {
    "turned": ({"torque_actual_value": other(lambda v: -v)}, "turned"),
    "torque of another axis": ({"torque_actual_value": other(lambda v: np.roll(v, 700))}, "belong"),
    "torque of no axis": ({"torque_actual_value": other(noise)}, "belong"),
    "saturated": (
        {"torque_actual_value": other(lambda v: np.clip(40 * v, -3000, 3000))}, "at its limit"),
    "torque in another unit": ({"torque_actual_value": other(lambda v: 10 * v)}, "rated torque"),
    "torque too small": ({"torque_actual_value": other(lambda v: v / 10)}, "units"),
    "positions in another unit": (dict.fromkeys(BOTH, other(lambda v: 10 * v)), "units"),
    "set-points in another unit": ({"target_position": other(lambda v: 1000 * v)}, "travel"),
    "set-points of another axis": ({"target_position": other(lambda v: v + 7e6)}, "home it"),
}


@pytest.mark.parametrize(("change", "said"), UNFIT.values(), ids=UNFIT)
def test_a_log_that_does_not_fit_together_is_refused_in_one_line(recorded, change, said):
    with pytest.raises(Unusable, match=said) as error:
        usable(experiment(streams(recorded[0], **change), linear_axis(), "x"))
    assert "\n" not in str(error.value)


def test_moves_in_one_direction_are_refused(tmp_path):
    at = np.clip(np.arange(3000) * 1e-3, 0, 2.8) / 0.35
    steps = np.floor(at) + 0.5 - 0.5 * np.cos(np.pi * (at % 1))  # eight, all to the right
    log = made.csp_log(linear_axis(), tmp_path / "up.log", np.random.default_rng(1),
                       places=0.05 + 0.05 * steps)
    with pytest.raises(Unusable, match="one direction"):
        usable(experiment(streams(log), linear_axis(), "x"))


def test_an_axis_that_was_not_homed_is_a_note(recorded):
    far = dict.fromkeys(BOTH, other(lambda v: v + 7e6))
    found = experiment(streams(recorded[0], **far), linear_axis(), "x")
    usable(found)
    assert any("not homed" in note for note in found.notes)


def test_the_log_of_another_drive_is_refused(recorded):
    for drive in ("kollmorgen_akd", "metronix_ars2000"):
        with pytest.raises(Unusable, match="--drive"):
            logs.read([recorded[0]], linear_axis(drive), drive, "x")


def test_a_twin_that_faults_where_the_log_runs_on_says_so(recorded):
    known = FAMILIES["rigid"].given(
        objects={
            "motor_temperature_limit": 1,
            "motor_thermal_resistance": 10**6,
            "motor_thermal_time": 1,
            "motor_winding_loss": 10**6,
        }
    )
    (found,) = logs.read([recorded[0]], known.make("generic"), "generic", "x")
    with pytest.raises(Unusable, match="fault"):
        fit([found], "generic", known, gains_known=True)


def test_a_table_without_its_current_scale_says_which_option(tmp_path):
    table = tmp_path / "scope.csv"
    rows = "".join(f"{n},{n % 50},{n % 7}\n" for n in range(400))
    table.write_text("t,x,i\n" + rows)
    with pytest.raises(Unusable, match="--torque-constant"):
        logs.read([table], linear_axis(), "generic", "x", columns="time=t:ms,target_position=x:mm,"
                  "position_actual_value=x:mm,current_actual_value=i:A")


def test_ctrl_c_keeps_the_best_so_far(recorded, tmp_path, monkeypatch, capsys):
    log, hidden = recorded
    descend, count = Search.descend, []

    def interrupted(*arguments, **options):
        count.append(None)
        if len(count) == 2:
            raise KeyboardInterrupt
        return descend(*arguments, **options)

    monkeypatch.setattr(Search, "descend", interrupted)
    drive = linear_axis().drives["x"].axis.od
    gains = tmp_path / "gains.json"
    gains.write_text(json.dumps({n: int(getattr(drive, n)) for n in GAIN_OBJECTS}))
    folder = tmp_path / "twin"
    assert main(["twin", str(log), "--mechanics", "rigid", "--read-gains", str(gains),
                 "-o", str(folder)]) == 1
    found = json.loads((folder / "twin.json").read_text())
    assert found["verdict"] == "interrupted"
    assert found["parameters"]["payload"]["value"] == pytest.approx(hidden["payload"], rel=0.05)
    assert "interrupted: the best so far" in capsys.readouterr().out
    assert (folder / "report.md").is_file()


def test_a_log_without_a_drive_is_one_line(tmp_path, capsys):
    log = tmp_path / "other.log"
    log.write_text("(1.0) can0 123#00\n(1.1) can0 123#01\n")
    assert main(["twin", str(log), "-o", str(tmp_path / "out")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


# ------------------------------------------------------------------- parts


def test_a_plan_stays_within_its_limits():
    period = 1e-3
    limits = Limits(0.1, 0.4, 0.5, 5.0, 200.0)
    found = plan(limits, period, sweep=True)
    assert 0.1 <= found.min() < found.max() <= 0.4
    assert abs(np.diff(found)).max() / period <= 0.5 * 1.01
    assert abs(np.diff(found, 2)).max() / period**2 <= 5.0 * 1.1


def made_up(time, position, torque):
    """An experiment of samples alone."""
    return Experiment(
        name="log", mode=8, cycle=1e-3, period=1e-3, rows={}, arrives=np.ones(len(time)),
        begins=0, start=0.0, time=time, position=position, torque=torque, quanta=(1e-6, 1e-3),
    )


@pytest.mark.parametrize(("own", "loss"), [(0.0, 0.0), (0.004, 0.54)])
@pytest.mark.parametrize("lost", [0.0, 0.005, 0.05])
def test_regression_finds_an_inertia_of_made_up_torques(lost, own, loss):
    """Closed form: torque = Jm a + T (1 + loss), or (1 - loss) where the load drives, with
    T = J a + Tc sign(v) + B v + T0; and samples that the logger missed.
    """
    time = np.arange(0, 4, 1e-3)
    position = 0.5 * np.sin(3 * time) + 0.1 * np.sin(11 * time)
    speed, acceleration = (
        np.gradient(position, time),
        np.gradient(np.gradient(position, time), time),
    )
    carried = 0.02 * acceleration + 0.1 * np.sign(speed) + 0.05 * speed + 0.01
    torque = own * acceleration + carried + loss * abs(carried) * np.sign(speed)
    keep = np.random.default_rng(1).random(len(time)) >= lost
    found = regress([made_up(time[keep], position[keep], torque[keep])], 1.0, own, loss)
    np.testing.assert_allclose(
        [found.inertia, found.coulomb, found.viscous, found.load],
        [own + 0.02, 0.1, 0.05, 0.01],
        rtol=0.05,
    )


def test_whitening_takes_the_colour_of_an_autoregression():
    """Oracle: the process that made it."""
    rng = np.random.default_rng(1)
    process = np.zeros((20_000, 2))
    shocks = rng.normal(size=process.shape) * [1.0, 0.3]
    for n in range(1, len(process)):
        process[n] = np.array([[0.8, 0.1], [-0.2, 0.5]]) @ process[n - 1] + shocks[n]
    noise = colour([process], [np.ones(len(process), bool)])
    white = noise.white(process)[50:]
    assert np.cov(white.T) == pytest.approx(np.eye(2), abs=0.05)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.02
    assert isinstance(noise, Noise)


def test_columns_of_a_table_are_brought_into_si(tmp_path):
    table = tmp_path / "scope.csv"
    table.write_text("t,x,i\n0,1.5,250\n10,2.5,-250\n")
    source = Source(
        table, "generic", "time=t:ms,position_actual_value=x:mm,current_actual_value=i:mA"
    )
    signals = source.signals("scope.csv")
    assert signals["position_actual_value"].value.tolist() == [1.5e-3, 2.5e-3]
    assert signals["position_actual_value"].time.tolist() == [0.0, 0.01]
    assert signals["current_actual_value"].unit == "A"


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ("time=t:ms,position_actual_value=y:mm", "no column 'y'"),
        ("time=t:ms,position_actual_value=x:inch", "unit 'inch'"),
        ("position_actual_value=x:mm", "name the time"),
        ("time", "NAME=HEADING"),
    ],
)
def test_columns_that_are_none_are_refused(tmp_path, columns, said):
    table = tmp_path / "scope.csv"
    table.write_text("t,x\n0,1.5\n10,2.5\n")
    with pytest.raises(ValueError, match=said):
        Source(table, "generic", columns)


def test_commands_take_a_twin(folder, recorded, tmp_path, capsys):
    assert main(["replay", str(recorded[0]), "--twin", str(folder), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert (tmp_path / "replay.csv").is_file()
    assert float(said.split("(")[1].split("%")[0]) > 99.9


@pytest.mark.parametrize("name", FAMILIES)
def test_what_a_family_looks_for_is_there_in_its_machine(name):
    """And can be set to another value than it has, with which it is another machine."""
    family = FAMILIES[name]
    joint = parameters.Joint(family.make("generic"), family.axis)
    for unknown in family.unknown:
        row = parameters.known(joint, unknown)
        value = row.get(joint)
        wanted = 1.25 * value if value else 0.01
        row.set(joint, wanted)
        assert row.get(joint) == pytest.approx(wanted)
    assert parameters.PARAMETERS[family.mass].get(joint) > 0.0


@pytest.mark.parametrize(
    ("moves_at", "torque", "known"),
    [(0.5, 0.0, 0.15), (0.5, 0.11, 0.55), (0.0, 0.11, 0.15), (1.98, 0.11, 1.0)],
)
def test_a_torque_at_rest_counts_from_where_the_axis_has_slid(moves_at, torque, known):
    """No torque, one that friction has left, none at rest, and a move that the log cuts off."""
    time = np.arange(0.0, 2.0, 1e-3)
    position = 0.05 * np.maximum(time - moves_at, 0.0)
    found = made_up(time, position, np.full(len(time), torque))
    assert found.known == pytest.approx(known, abs=0.02)
    assert found.moving.any()
