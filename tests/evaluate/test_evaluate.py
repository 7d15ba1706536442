"""Fixed episodes, their metrics, intervals, and the files of eval, compare and benchmark."""

import csv
import json
import math
from importlib import resources

import numpy as np
import pytest
from later import Later

from servogym.drive.kernel.words import ENABLED, Mode
from servogym.drive.master import Master
from servogym.envs import linear_axis
from servogym.envs.engine import loop, probe
from servogym.envs.engine.machine import NO_IMAGES
from servogym.envs.masters.port import MachinePort
from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.envs.tasks.homing import HomingEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.tasks.sway import GantrySwayEnv
from servogym.training import cli
from servogym.training.evaluate import compare, comparison, tables
from servogym.training.evaluate.episodes import FIRST_SEED, Evaluator
from servogym.training.evaluate.homing import interval, one_sided, repeatability, two_sided
from servogym.training.evaluate.metrics import METRICS, Difference, iqm
from servogym.training.policies import make
from servogym.training.report import number

pictured = Later("servogym.training.pictures.episode")


@pytest.fixture
def undrawn(monkeypatch):
    """Without the pictures of a comparison, where numbers are asked for."""
    monkeypatch.setattr(compare, "draw", lambda *_: None)
    monkeypatch.setattr(pictured, "draw", lambda *_: None)


def test_the_evaluation_is_what_the_environments_say_one_by_one():
    result = Evaluator("CompliantAxis-v0", episodes=3, seed=2).run("ruckig+zv")
    env = CompliantAxisEnv()
    policy = make("ruckig+zv", env)
    for i, seed in enumerate(result.seeds):
        assert seed == FIRST_SEED + 2000 + i
        observation, info = env.reset(seed=seed)
        policy.reset(observation, info)
        total = cost = 0.0
        for _ in range(env.STEPS):
            observation, reward, _, _, info = env.step(policy.act(observation))
            total += reward
            cost += info["cost"]
        assert result.values["episode_return"][i] == total
        assert result.values["success"][i] == info["is_success"]
        assert result.values["limited"][i] == pytest.approx(cost / env.STEPS, abs=1e-9)


def test_measuring_does_not_change_the_motion():
    def places(measured):
        env = LinearAxisEnv()
        if measured:
            env.machine.probe()
        observation, info = env.reset(seed=1)
        policy = make("ruckig", env)
        policy.reset(observation, info)
        return [(observation := env.step(policy.act(observation))[0]).tobytes() for _ in range(50)]

    assert places(True) == places(False)


def test_the_probe_measures_every_physics_step():
    """Against the same run looked at step by step from Python."""
    machine = linear_axis(stiffness=20_000.0, structural_damping=6.3)
    machine.reset(positions={"x": 0.1})
    master, x = Master(MachinePort(machine), "x"), machine.drives["x"]
    x.write("home_offset", -100_000)
    master.enable()
    master.home(37)
    master.set_mode(Mode.PROFILE_POSITION)
    x.write("target_position", 120_000)
    x.write("controlword", ENABLED | 0x10)
    machine.probe()
    probe.begin(machine, 0.2, goal=0.12, window=100e-6)
    seen, limited = [], 0
    for _ in range(800):
        loop.run(machine.addresses, 1, NO_IMAGES, NO_IMAGES)
        axis = machine.axes[0]
        limited += bool(int(axis.od.statusword) & 0x800)
        error = 1e-6 * int(axis.od.following_error_actual_value)
        seen.append((*machine.data.qpos, machine.data.qvel[0], float(axis.torque), error))
    position, deflection, velocity, torque, error = np.array(seen).T
    (p,), gear = machine.probes, float(machine.couplings[0].gear)
    away = position + deflection - 0.12
    assert p.ticks == 800
    assert p.limited == limited
    assert p.outside == np.flatnonzero(np.abs(away) > 100e-6)[-1] + 1
    assert p.overshoot == away.max() > 0
    assert p.torque_peak == np.abs(torque).max() > 0.2
    assert p.torque_squares == pytest.approx((torque**2).sum())
    assert p.error_peak == pytest.approx(np.abs(error).max())
    assert p.error_squares == pytest.approx((error**2).sum())
    assert p.work == pytest.approx(np.maximum(torque * velocity * gear, 0).sum() * 0.25e-3)
    assert (p.lowest, p.highest) == (deflection[600:].min(), deflection[600:].max())
    steps = np.concatenate([[0.0, 0.0], velocity[19::20]])
    jerk = np.diff(steps, 2) / 5e-3**2
    assert p.jerks == 40
    assert p.jerk_squares == pytest.approx((jerk**2).sum())


def test_the_figures_of_a_move_are_those_of_mechanics():
    result = Evaluator("LinearAxis-v0", episodes=1, options=[{"start": 0.1, "goal": 0.4}]).run(
        "jerk_limited"
    )
    value = {name: float(values[0]) for name, values in result.values.items()}
    mass = 6.5 + 6e-5 * (2 * math.pi / 0.06) ** 2  # kg, at 1 m/s
    friction = 12.0 * 0.3 + 20.0 * 0.25  # J, while it is driven
    assert 0.5 * mass < value["energy"] < 0.5 * mass + friction
    duration = 0.3 / 1.0 + 1.0 / 10.0 + 10.0 / 1000.0  # s, with its ramps of acceleration
    assert duration - 0.03 < value["settling_time"] < duration + 0.05
    assert 0.0 < value["overshoot"] < 200.0
    # four ramps of acceleration take 10 ms at 1000 m/s³ each
    assert value["rms_jerk"] == pytest.approx(1000 * math.sqrt(0.04), rel=0.35)


def test_settling_overshoot_and_sway_of_a_hanging_load_are_those_of_the_load():
    result = Evaluator("GantrySway-v0", episodes=3).run("ruckig+zvd")
    env = GantrySwayEnv()
    policy = make("ruckig+zvd", env)
    for i, seed in enumerate(result.seeds):
        observation, info = env.reset(seed=seed)
        policy.reset(observation, info)
        data, side = env.machine.data, math.copysign(1, observation[0])
        unsettled, sways, beyond = 0, [], [0.0]
        for step in range(env.STEPS):
            observation, *_, info = env.step(policy.act(observation))
            unsettled = unsettled if info["is_success"] else step + 1
            sways.append(info["sway"])
            load = data.joint("x").qpos[0] + (
                info["parameters"]["cable_length"] * math.sin(data.joint("sway_x").qpos[0])
            )
            beyond.append(side * (load - info["goal_x"]))
        assert result.values["settling_time"][i] == pytest.approx(0.01 * unsettled)
        assert result.values["sway"][i] == pytest.approx(1e3 * max(sways[300:]))
        assert result.values["overshoot"][i] == pytest.approx(1e6 * max(beyond), abs=0.1)
    assert result.values["success"].any()


def test_a_fault_counts_as_the_whole_episode():
    result = Evaluator("LinearAxis-v0", episodes=4).run("random")
    faulty = result.values["faults"] > 0
    assert faulty.any()
    assert all(result.faults[i].startswith("8611h") for i in np.flatnonzero(faulty))
    assert (result.values["settling_time"][faulty] == 1.0).all()


def test_a_built_in_method_is_worth_what_an_agent_gets_for_the_same_figures():
    env = HomingEnv()
    observation, info = env.reset(seed=3)
    policy = make("search", env)
    policy.reset(observation, info)
    total, terminated = 0.0, False
    while not terminated:
        observation, reward, terminated, _, info = env.step(policy.act(observation))
        total += reward
    figures = env.built_in(23)._replace(
        error=info["error"], time=info["time"], impact_energy=info["impact_energy"],
        greatest_torque=info["greatest_torque"],
    )
    assert env.worth(figures) == pytest.approx(total, abs=1e-9)
    result = Evaluator("Homing-v0", episodes=2).run("built_in:17")
    assert result.values["success"].all()
    assert (result.values["reference_error"] < 5).all()


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end():
    assert iqm(np.array([9.0, 1.0, 2.0, -7.0])) == 1.5
    assert iqm(np.arange(8.0)) == 3.5
    assert iqm(np.array([0, 1, 2, 3, 100.0])) == pytest.approx((0.75 + 2 + 0.75 * 3) / 2.5)
    assert iqm(np.array([4.0])) == 4.0


def test_holding_still_scores_0_and_the_reference_1():
    results = comparison.evaluate(
        "LinearAxis-v0", ["hold", "ruckig", "proportional"], "generic", 6, 0
    )
    hold, ruckig, proportional = (
        s.iqm for s in tables.summaries(results)["score"] if s is not None
    )
    assert hold == pytest.approx(0.0, abs=1e-12)
    assert ruckig == pytest.approx(1.0)
    assert 0.5 < proportional < 1.0


def test_each_policy_plays_the_same_episodes_in_the_environment_it_needs():
    ruckig, pd = comparison.evaluate("LinearAxis-v0", ["ruckig", "pd"], "generic", 4, 0)
    assert ruckig.seeds == pd.seeds
    assert ruckig.values["success"].all()
    assert pd.values["success"].all()
    assert iqm(ruckig.values["score"]) == pytest.approx(1.0)
    assert 0.8 < iqm(pd.values["score"]) < 1.0
    assert ruckig.by_training("peak_error") is not None
    assert pd.by_training("peak_error") is None, "in cst nothing follows a position"
    heavy, hold = comparison.evaluate(
        "LinearAxis-v0", ["pd", "hold"], "generic", 4, 0, {"payload": 20.0, "mode": "cst"}
    )
    assert (heavy.values["settling_time"] > pd.values["settling_time"]).all()
    assert iqm(hold.values["score"]) == pytest.approx(0.0, abs=1e-3), "no torque, no motion"


def test_values_are_in_the_order_of_the_episodes_whichever_is_traced():
    """Jobs with the traced episode are played first; resampling depends on the order."""
    first, last = (
        comparison.evaluate("LinearAxis-v0", ["proportional"], "generic", 11, 0, traced=traced)[0]
        for traced in (0, 10)
    )
    for metric, values in first.values.items():
        np.testing.assert_array_equal(values, last.values[metric], metric)


def test_arguments_of_the_environment_are_on_the_page(tmp_path):
    arguments = "eval LinearAxis-v0 --policy pd --argument mode=cst --argument payload=2"
    assert cli.main([*arguments.split(), "--episodes", "2", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "eval.md").read_text(encoding="utf-8")
    assert "--argument mode=cst --argument payload=2" in page
    assert "pd in an environment with mode=cst" in page


def test_there_is_no_score_where_the_reference_earns_no_more_than_holding_still():
    low, high = np.array([1.0, 3.0]), np.array([4.0, 6.0])
    assert comparison.scores(high, low, high).tolist() == pytest.approx([2 / 3, 4 / 3])
    assert np.isnan(comparison.scores(high, high, low)).all()
    assert np.isnan(comparison.scores(high, low, low)).all()


def test_one_seed_writes_the_same_bytes(tmp_path):
    for folder in ("a", "b"):
        arguments = "compare CompliantAxis-v0 --policies hold,ruckig+zv --episodes 4 --seed 1"
        assert cli.main([*arguments.split(), "--out", str(tmp_path / folder)]) == 0
    for name in ("compare.md", "compare.json", "compare.png", "compare_trace.png"):
        first, second = ((tmp_path / folder / name).read_bytes() for folder in ("a", "b"))
        assert first == second, name
    data = json.loads((tmp_path / "a" / "compare.json").read_text(encoding="utf-8"))
    assert data["command"].startswith("servogym compare CompliantAxis-v0 --policies hold,ruckig+zv")
    assert data["mujoco"]
    values = data["policies"]["ruckig+zv"]["episodes"]
    assert len(values["vibration"]) == 4
    assert set(values) <= {"score", *METRICS}
    page = (tmp_path / "a" / "compare.md").read_text(encoding="utf-8")
    assert "| settling (s) |" in page
    assert "```sh\nservogym compare" in page


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (
            "eval Moon-v0 --policy hold",
            "unknown environment 'Moon-v0': choose one of LinearAxis-v0",
        ),
        ("eval LinearAxis-v0 --policy x", "policy 'x' is unknown"),
        ("eval LinearAxis-v0 --policy hold --episodes 0", "--episodes: 0 is out of range 1..1000"),
        ("eval LinearAxis-v0 --policy hold --drive festo_cmmp_as", "has no mode cyclic_sync"),
        ("compare LinearAxis-v0 --policies ,", "lists nothing: give words with commas between"),
        ("benchmark homing --drive bonfiglioli_act", "has no homing method"),
        ("compare LinearAxis-v0 --policies ruckig --argument mode=cst", "with mode='csp'"),
        ("eval LinearAxis-v0 --policy hold --argument weight=3", "has no argument 'weight'"),
        ("benchmark positioning --drive festo_cmmp_as", "has no mode cyclic_sync_position"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_fix(arguments, says, tmp_path, refused):
    assert says in refused([*arguments.split(), "--out", str(tmp_path)])


def test_the_homing_benchmark_tells_methods_apart(tmp_path):
    assert cli.main(["benchmark", "homing", "--quick", "--out", str(tmp_path)]) == 0
    rows = _rows(tmp_path / "homing.csv")
    assert {row["method"] for row in rows} == {"1", "17", "23", "-17"}
    assert {row["mechanics"] for row in rows} == {"rigid", "ball_screw"}
    assert all(row["attained"] == "1" for row in rows)
    impacts = {
        m: max(float(r["impact_J"]) for r in rows if r["method"] == m) for m in ("17", "-17")
    }
    assert impacts["17"] == 0.0 < impacts["-17"]
    assert (tmp_path / "homing.png").read_bytes()[:4] == b"\x89PNG"
    assert "| 17 | rigid |" in (tmp_path / "homing.md").read_text(encoding="utf-8")


def test_the_positioning_benchmark_tells_strategies_apart(tmp_path):
    assert cli.main(["benchmark", "positioning", "--quick", "--out", str(tmp_path)]) == 0
    rows = _rows(tmp_path / "positioning.csv")

    def mean(strategy, mechanics, name):
        picked = [r for r in rows if (r["strategy"], r["mechanics"]) == (strategy, mechanics)]
        return np.mean([float(row[name]) for row in picked]) if picked else None

    assert mean("ruckig", "rigid", "settling_s") < mean("jerk_limited", "rigid", "settling_s")
    assert mean("ruckig+zv", "rigid", "settling_s") is None, "nothing to shape for"
    zv, direct = (mean(s, "toothed_belt", "overshoot_um") for s in ("ruckig+zv", "ruckig"))
    assert zv < direct
    assert (tmp_path / "positioning.png").read_bytes()[:4] == b"\x89PNG"


def test_repeatability_is_that_of_iso_230_2():
    assert repeatability(np.array([1.0, 3.0])) == pytest.approx(4 * math.sqrt(2))
    assert math.isnan(repeatability(np.array([1.0])))
    # ISO 230-2: both sides with s = 1 µm, 10 µm apart: 10 + 2 · 2 · 1
    one = np.array([-1.0, 0.0, 1.0])
    assert two_sided(one, one + 10.0) == pytest.approx(14.0)
    assert two_sided(one, np.array([])) == pytest.approx(4.0)
    low, high = interval(two_sided, one, one + 10.0)
    assert low <= 14.0 <= high
    assert one_sided(one, 3.0 * one) == pytest.approx(12.0)
    low, high = interval(one_sided, one, 3.0 * one)
    assert low <= 12.0 <= high


def test_numbers_have_significant_digits():
    shown = [number(value) for value in (0.0, 12345.6, 0.123456, -2.0, 2e-7, math.nan)]
    assert shown == ["0", "12346", "0.123", "-2.00", "2.00e-07", "–"]


def _rows(path):
    """Of a CSV, its head of comments left out."""
    lines = path.read_text(encoding="utf-8").splitlines()
    assert any(line.startswith("# command: servogym benchmark") for line in lines)
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def test_the_committed_table_is_reproduced_bit_for_bit(tmp_path, undrawn):
    """The columns that need no learned policy, on the versions it was made with."""
    page = resources.files("servogym.assets") / "policies" / "CompliantAxis-v0" / "compare.md"
    committed = page.read_text(encoding="utf-8")
    arguments = ["--policies", "hold,ruckig+zvd", "--out", str(tmp_path)]
    assert cli.main(["compare", "CompliantAxis-v0", *arguments]) == 0
    again = (tmp_path / "compare.md").read_text(encoding="utf-8")
    if committed.splitlines()[-1] != again.splitlines()[-1]:
        pytest.skip(f"made with {committed.splitlines()[-1]}")

    def cells(text):
        table = text.partition("\n## ")[0]  # the others depend on the best of the policies
        rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line[:1] == "|"]
        return {row[0]: dict(zip(rows[0][1:], row[1:], strict=True)) for row in rows[2:]}

    here, there = cells(again), cells(committed)
    assert len(here) > 10
    for metric, row in here.items():
        for policy, cell in row.items():
            assert there[metric][policy] == cell, (metric, policy)


def test_doing_nothing_is_no_merit_and_rounding_is_no_number():
    """`hold` was told in bold with 5.40e-23 J."""
    assert number(5.4e-23) == number(-2.2e-17) == "0"
    assert number(2e-9) == "2.00e-09"
    found = Difference(-13.6, -17.3, -9.57)
    assert compare._apart("energy", found, "low", "hold") == "-13.6 [-17.3, -9.57]"
    assert compare._apart("energy", found, "low", "ruckig") == "**-13.6 [-17.3, -9.57]**"
