"""Policies through one door: what they may know, and that each does its task."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from servogym.envs import ON_MODELS, TASKS
from servogym.envs.engine import probe
from servogym.envs.plants.axis_parameters import LinearAxisParameters
from servogym.envs.tasks.compliant import PARAMETERS as COMPLIANT
from servogym.envs.tasks.compliant import CompliantAxisEnv
from servogym.envs.tasks.gantry_sync import GantrySyncEnv
from servogym.envs.tasks.homing import HomingEnv
from servogym.envs.tasks.positioning import LinearAxisEnv
from servogym.envs.tasks.sway import GantrySwayEnv
from servogym.envs.tasks.tracking import LinearAxisTrackingEnv
from servogym.training.evaluate.episodes import Evaluator
from servogym.training.policies import (
    ANYWHERE,
    POLICIES,
    Bound,
    BuiltIn,
    make,
    names,
    needed,
    trainings,
)
from servogym.training.policies.datasheet import Vibration, datasheet
from servogym.training.policies.idle import Hold
from servogym.training.policies.lqr import gain, model
from servogym.training.policies.profiles import (
    Bounds,
    notched,
    of_the_drive,
    shaped,
    time_optimal,
    trapezoid,
)

MOVE = {"start": 0.1, "goal": 0.3}


def play(env, policy, seed=3, **options):
    """-> return, the last info."""
    observation, info = env.reset(seed=seed, options=options)
    policy.reset(observation, {})
    total = 0.0
    for _ in range(env.STEPS):
        observation, reward, terminated, _, info = env.step(policy.act(observation))
        total += reward
        if terminated:
            break
    return total, info


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.ID)
def test_actions_are_in_the_space_and_an_episode_does_not_depend_on_the_one_before(task):
    for name in names(task):
        env = task(**needed(name))
        if name not in names(env):
            assert task is LinearAxisEnv, name
            with pytest.raises(ValueError, match="no spring that could vibrate"):
                make(name, env)
            continue
        policy = make(name, env, seed=5)
        if isinstance(policy, BuiltIn | Bound):
            continue
        runs = []
        for _ in range(2):
            observation, info = env.reset(seed=4)
            policy.reset(observation, info)
            actions = []
            for _ in range(15):
                actions.append(policy.act(observation).copy())
                assert env.action_space.contains(actions[-1]), name
                observation, *_ = env.step(actions[-1])
            runs.append(np.array(actions))
        np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("name", ["trapezoid", "jerk_limited", "ruckig", "proportional"])
def test_a_move_ends_in_the_window_and_earns_more_than_twice_of_holding_still(name):
    env = LinearAxisEnv()
    held, _ = play(env, make("hold", env), **MOVE)
    total, info = play(env, make(name, env), **MOVE)
    assert info["is_success"]
    assert total > 2 * held + 80


def test_ruckig_at_the_drives_limits_is_the_fastest_of_the_profiles():
    env = LinearAxisEnv()
    others = [n for n in names(env) if "+" not in n and n not in ("pd", "bound", "tuned_ruckig")]
    totals = {n: play(env, make(n, env), **MOVE)[0] for n in others}
    assert max(totals, key=totals.get) == "ruckig"
    assert play(env, make("tuned_ruckig", env), **MOVE)[0] > totals["ruckig"]


def test_a_shaper_leaves_less_vibration():
    env = CompliantAxisEnv(randomise={})
    energy = {
        name: play(env, make(name, env), **MOVE)[1]["energy"]
        for name in ("ruckig", "ruckig+zv", "ruckig+zvd")
    }
    assert energy["ruckig+zv"] < 0.05 * energy["ruckig"]
    assert energy["ruckig+zvd"] < 0.05 * energy["ruckig"]


@pytest.mark.parametrize("goal", [0.15, 0.3])
def test_feed_forward_of_torque_lowers_the_peak_following_error(goal):
    env = CompliantAxisEnv(randomise={})
    peaks = {}
    for name in ("ruckig", "ruckig+ff"):
        env.machine.probe()
        observation, info = env.reset(seed=3, options={"start": 0.1, "goal": goal})
        probe.begin(env.machine, 2.0)
        policy = make(name, env)
        policy.reset(observation, info)
        for _ in range(env.STEPS):
            observation, *_ = env.step(policy.act(observation))
        peaks[name] = env.machine.probes["error_peak"][0]
    assert peaks["ruckig+ff"] < 0.99 * peaks["ruckig"]


def test_the_model_of_the_regulator_swings_as_the_data_sheet_says():
    a, b = model(Vibration(60.0, 0.02), 0.005)
    (value, _) = np.linalg.eigvals(a[2:4, 2:4])
    assert abs(value) == pytest.approx(np.exp(-0.02 * 60.0 * 0.005))
    assert abs(np.angle(value)) == pytest.approx(60.0 * np.sqrt(1 - 0.02**2) * 0.005)
    # a change of the velocity by 1 m/s leaves the load behind, a step late
    first = b[:, 0]
    assert first.tolist() == [0.005, 1.0, 0.0, 0.0, 1.0]
    second = a @ first
    assert second[2] == pytest.approx(-0.005, rel=0.05)


@pytest.mark.parametrize("task", [CompliantAxisEnv, GantrySwayEnv])
def test_the_regulator_is_stable_on_loads_far_from_the_nominal(task):
    env = task()
    nominal, dt = datasheet(env).axis.vibration, env.step_time
    k = gain(nominal, dt)[None]
    # squared: half to twice the stiffness, 2 to 8 of 5 kg; cables of 0.2 to 0.4 of 0.3 m
    for share in (0.6, 1.0, 1.5):
        a, b = model(nominal._replace(frequency=share * nominal.frequency), dt)
        assert np.abs(np.linalg.eigvals(a - b @ k)).max() < 1.0


@pytest.mark.parametrize("task", ["CompliantAxis-v0", "GantrySway-v0"])
def test_feedback_of_the_load_settles_it_sooner_than_the_best_shaper(task):
    evaluator = Evaluator(task, episodes=12)
    lqr, zvd = (evaluator.run(name).values for name in ("lqr", "ruckig+zvd"))
    evaluator.close()
    assert lqr["success"].all()
    assert lqr["settling_time"].mean() < 0.8 * zvd["settling_time"].mean()


def test_the_regulator_knows_how_far_the_weight_bends_the_spring():
    parameters = replace(COMPLIANT, inclination=30.0)
    env = CompliantAxisEnv(parameters=parameters, randomise={})
    _, info = play(env, make("lqr", env), **MOVE)
    assert info["deflection"] == pytest.approx(-5.0 * 9.81 * 0.5 / 20_000.0, rel=0.01)
    assert info["is_success"]


@pytest.mark.parametrize(
    ("task", "arguments", "name", "message"),
    [
        (CompliantAxisEnv, {"load_sensor": False}, "lqr", "make .* with load_sensor=True"),
        (GantrySwayEnv, {"sway_sensor": False}, "lqr", "make .* with sway_sensor=True"),
        (CompliantAxisEnv, {"torque_range": 0.0}, "ruckig+ff", "a torque_range above 0"),
        (LinearAxisEnv, {}, "pd", "does not command mode = 'csp': make .* with mode='cst'"),
        (LinearAxisEnv, {"mode": "cst"}, "ruckig", "command mode = 'cst': make .* mode='csp'"),
        (LinearAxisEnv, {"mode": "csv"}, "trapezoid", "command mode = 'csv': make .* mode='csp'"),
    ],
)
def test_a_policy_says_which_argument_it_needs(task, arguments, name, message):
    with pytest.raises(ValueError, match=message):
        make(name, task(**arguments))


def test_without_scipy_the_regulator_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy.linalg", None)
    with pytest.raises(ImportError, match=r"pip install 'servogym\[lqr\]'"):
        make("lqr", GantrySwayEnv())


@pytest.mark.parametrize(("start", "goal"), [(0.03, 0.47), (0.4, 0.2), (0.3, 0.301)])
@pytest.mark.parametrize("payload", [1.0, 20.0])
def test_pd_brings_the_axis_to_the_goal_without_overshoot(start, goal, payload):
    env = LinearAxisEnv(mode="cst", payload=payload)
    policy, side = make("pd", env), np.sign(goal - start)
    observation, info = env.reset(seed=1, options={"start": start, "goal": goal})
    policy.reset(observation, info)
    beyond = []
    for _ in range(env.STEPS):
        observation, *_, info = env.step(policy.act(observation))
        beyond.append(-side * info["distance"])
    assert info["is_success"]
    assert max(beyond) < env.tolerance
    assert not info["fault"]


def test_feed_forward_of_the_data_sheet_takes_a_third_of_the_tracking_error_where_it_is_true():
    env = LinearAxisTrackingEnv(reference="pick_and_place", randomise={})
    held, plain = play(env, make("hold", env))
    total, info = play(env, make("feed_forward", env))
    assert info["rms_error"] < 0.67 * plain["rms_error"]
    assert total > held


@pytest.mark.parametrize("reference", ["home_switch", "negative_limit_switch", "stop"])
def test_the_search_finds_each_reference(reference):
    env = HomingEnv(reference=reference)
    total, info = play(env, make("search", env), start=0.2)
    assert info["is_success"]
    assert total > 0.5


def test_the_plc_commissions():
    (task,) = (task for task in TASKS if "Commissioning" in task.ID)
    env = task()
    assert play(env, make("plc", env))[0] == pytest.approx(1.0)


@pytest.mark.parametrize("axes", ["x", "xy"])
def test_a_shaped_path_of_the_trolley_leaves_the_load_calm_on_the_nominal_cable(axes):
    env = GantrySwayEnv(axes=axes, randomise={})
    move = {"start": [0.1] * len(axes), "goal": [0.4] * len(axes)}
    sway = {}
    for name in ("trapezoid", "ruckig", "ruckig+zv", "ruckig+zvd"):
        policy, (observation, info) = make(name, env), env.reset(seed=3, options=move)
        policy.reset(observation, info)
        seen = []
        for _ in range(env.STEPS):
            observation, *_, info = env.step(policy.act(observation))
            seen.append(info["sway"])
        sway[name] = max(seen[-100:])  # of nearly a period
    assert info["is_success"]
    assert sway["ruckig"] > 0.1 < sway["trapezoid"]
    assert sway["ruckig+zv"] < 0.05 * sway["ruckig"]
    assert sway["ruckig+zvd"] < 0.05 * sway["ruckig"]


def test_the_bounds_of_the_trolley_are_its_speed_and_the_torque_for_all_it_carries():
    env = GantrySwayEnv(axes="xy", speed=0.3)
    env.reset(seed=5)  # another payload and cable
    x, y = datasheet(env).axes
    bounds = of_the_drive(x)
    assert bounds.velocity == 0.3 == x.profile.velocity
    # bridge 6 kg, slide 2 kg, gripper 2.5 kg; rotor 6e-5 kg·m² at 60 mm a revolution
    assert x.mass(0.0) == pytest.approx(10.5 + 6e-5 * (2 * np.pi / 0.06) ** 2)
    assert x.carriage - y.carriage == pytest.approx(6.0)
    assert bounds.acceleration < 0.8 * 3 * 1.27 * (2 * np.pi / 0.06) / x.mass(5.0)


def test_a_policy_does_not_know_what_was_drawn():
    env = CompliantAxisEnv()
    before = datasheet(env)
    for seed in (1, 2):
        env.reset(seed=seed)
        assert datasheet(env) == before
    assert before.axis.payload == 5.0
    assert before.axis.heaviest == 8.0


def test_the_trapezoid_starts_and_ends_at_rest_within_its_bounds():
    bounds = Bounds(1.0, 10.0, np.inf)
    times = np.arange(0, 1, 1e-4)
    for way in (0.3, -0.02):
        path = trapezoid(way, bounds)(times)
        velocity = np.diff(path) / 1e-4
        assert path[0] == 0.0
        assert path[-1] == pytest.approx(way, abs=1e-12)
        assert np.abs(velocity).max() <= 1.0 + 1e-6
        assert np.abs(np.diff(velocity)).max() / 1e-4 <= 10.0 + 1e-3


def test_a_shaped_path_ends_where_the_path_does_and_does_not_excite_its_frequency():
    omega, ratio, dt = 60.0, 0.02, 1e-4
    times = np.arange(0, 1.0, dt)

    def swing(path):
        """Of a mass on a spring whose foot moves along the path, its energy at the end."""
        x = v = 0.0
        for foot in path:
            v += (omega**2 * (foot - x) - 2 * ratio * omega * v) * dt
            x += v * dt
        return v**2 + (omega * (x - path[-1])) ** 2

    path = trapezoid(0.1, Bounds(1.0, 10.0, np.inf))
    gentle = shaped(path, omega, ratio)
    assert gentle(times)[-1] == pytest.approx(0.1)
    assert swing(gentle(times)) < 0.01 * swing(path(times))


@pytest.mark.parametrize("frequency", [8.0, 120.0, 450.0, 700.0])
def test_a_notched_path_is_what_the_continuous_filter_makes_of_it(frequency):
    """The notch of a resonance above 500 Hz, half the usual sampling rate, was unstable."""
    signal = pytest.importorskip("scipy.signal")
    omega, ratio = 2 * np.pi * frequency, 0.02
    path = time_optimal(0.1, Bounds(1.0, 10.0, 1000.0))
    times = np.arange(0.0, 0.6, 2e-5)
    filter_ = ([1.0, 2 * ratio * omega, omega**2], [1.0, 2 * omega, omega**2])
    _, expected, _ = signal.lsim(filter_, path(times), times)
    assert np.abs(notched(path, omega, ratio)(times) - expected).max() < 2e-4


def test_too_heavy_a_load_for_the_torque_is_refused_with_its_numbers():
    env = LinearAxisEnv(parameters=LinearAxisParameters(payload=50.0, inclination=90.0))
    with pytest.raises(ValueError, match=r"choose a smaller payload than 50 kg"):
        of_the_drive(datasheet(env).axis)


@pytest.mark.parametrize(
    ("task", "name", "message"),
    [
        (LinearAxisEnv, "ruckik", "'ruckik' is unknown for servogym/LinearAxis-v0: did .* ruckig;"),
        (LinearAxisEnv, "x", "'x' is unknown for .*: choose one of hold, random, trapezoid"),
        (LinearAxisEnv, "plc", "is for servogym/Commissioning-v0"),
        (LinearAxisEnv, "ruckig+zv", "no spring that could vibrate"),
        (HomingEnv, "built_in:x", "after the colon comes a homing method"),
        (LinearAxisEnv, "nowhere.py:act", "there is no Python file nowhere.py"),
        (GantrySyncEnv, "learned", "nothing learned comes for servogym/GantrySync-v0"),
    ],
)
def test_a_wrong_policy_is_named(task, name, message):
    with pytest.raises(ValueError, match=message):
        make(name, task())


def test_a_set_point_policy_is_refused_where_the_agent_is_the_whole_master():
    with pytest.raises(ValueError, match='action="setpoint"'):
        make("ruckig", LinearAxisEnv(action="pdo"))


def test_a_function_of_a_file_is_a_policy(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("import numpy as np\n\ndef act(seen):\n    return np.zeros(1, np.float32)\n")
    env = LinearAxisEnv()
    assert play(env, make(f"{file}:act", env)) == play(env, make("hold", env))
    with pytest.raises(ValueError, match="has no function 'other'"):
        make(f"{file}:other", env)


def test_the_tasks_name_each_policy_of_the_table_and_no_other():
    every = (*TASKS, *ON_MODELS)
    for task in every:
        assert set(task.POLICIES) <= set(POLICIES) - set(ANYWHERE)
        assert task.REFERENCE in ("", *task.POLICIES)
    named = {name for task in every for name in task.POLICIES}
    assert named | set(ANYWHERE) == set(POLICIES)


def test_a_folder_of_the_name_of_a_policy_does_not_hide_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hold").mkdir()
    assert isinstance(make("hold", LinearAxisEnv()), Hold)


def test_trainings_are_the_seeds_of_a_folder(tmp_path):
    for seed in (2, 1):
        (tmp_path / f"seed_{seed}").mkdir()
    folders = trainings(str(tmp_path), LinearAxisEnv.ID)
    assert [folder[-6:] for folder in folders] == ["seed_1", "seed_2"]
    assert trainings(str(tmp_path / "seed_1"), LinearAxisEnv.ID) == [str(tmp_path / "seed_1")]
    assert trainings("hold", LinearAxisEnv.ID) == []


def test_the_quickest_method_finds_the_same_place_from_both_sides_within_the_tolerance():
    env = HomingEnv()
    slow, fast = make("built_in", env), make("built_in_fast", env)
    assert isinstance(slow, BuiltIn)
    assert isinstance(fast, BuiltIn)
    for start in (0.05, 0.45):
        env.reset(seed=2, options={"start": start})
        usual = env.built_in(slow.method, slow.objects)
        quick = env.built_in(fast.method, fast.objects)
        assert quick.attained
        assert abs(quick.error) < 0.25 * env.tolerance
        assert quick.time < 0.4 * usual.time
        assert quick.impact_energy == 0.0
    assert make("built_in_fast:29", env).method == 29
