"""stable-baselines3: its checker, the adapter beside DummyVecEnv, wrappers and PPO on it."""

import gymnasium as gym
import numpy as np
import pytest
from later import Later, only_with

import servogym.envs
from servogym.drive.kernel.words import Mode
from servogym.drive.model.model import load, model_names
from servogym.envs.environment.registry import task
from servogym.envs.environment.vector_env import ServoVectorEnv

PPO = Later("stable_baselines3", "PPO")
check_env = Later("stable_baselines3.common.env_checker", "check_env")
evaluate_policy = Later("stable_baselines3.common.evaluation", "evaluate_policy")
Monitor = Later("stable_baselines3.common.monitor", "Monitor")
DummyVecEnv = Later("stable_baselines3.common.vec_env", "DummyVecEnv")
VecMonitor = Later("stable_baselines3.common.vec_env", "VecMonitor")
VecNormalize = Later("stable_baselines3.common.vec_env", "VecNormalize")
sb3 = Later("servogym.training.learn.sb3")
pytestmark = only_with("stable_baselines3", reason="needs pip install 'servogym[train]'")

ID = "LinearAxis-v0"
TASKS = servogym.envs.TASKS


def lacking(model):
    """Modes without which a task that drives an axis from a bus cannot be done, by its id."""
    modes = set(load(model).modes)
    csp, hm, pv, pp = (
        Mode.CYCLIC_SYNC_POSITION, Mode.HOMING, Mode.PROFILE_VELOCITY, Mode.PROFILE_POSITION,
    )
    needed = {"servogym/Homing-v0": {hm, pv}, "servogym/Commissioning-v0": {hm, pp}}
    return {task.ID: needed.get(task.ID, {csp, hm}) - modes for task in TASKS}


@pytest.mark.parametrize("model", model_names())
@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.ID)
def test_the_checker_is_content_or_the_missing_mode_is_named(task, model):
    missing = lacking(model)[task.ID]
    if missing:
        with pytest.raises(ValueError, match="has no mode") as refusal:
            sb3.make(task.ID, 1, drive=model)
        assert any(mode.name.lower() in str(refusal.value) for mode in missing)
        return
    env = task(drive=model)
    check_env(env)
    env.close()


@pytest.mark.parametrize("arguments", [{}, {"action": "pdo", "history": 2}])
@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.ID)
def test_it_gives_what_a_dummy_vec_env_of_the_same_environments_gives(task, arguments):
    arguments = dict(arguments, max_episode_steps=20, faults={"short_circuit": 0.02})
    if task.ID == "servogym/Commissioning-v0":
        arguments.pop("action", None)
    dummy = DummyVecEnv([lambda: gym.make(task.ID, **arguments) for _ in range(3)])
    env = sb3.make(task.ID, 3, threads=2, **arguments)
    for peer in (dummy, env):
        peer.seed(11)
    np.testing.assert_array_equal(dummy.reset(), env.reset())
    assert dummy.reset_infos == env.reset_infos
    generator = np.random.default_rng(4)
    ends = faults = 0
    for _ in range(70):
        actions = generator.uniform(-0.2, 0.2, (3, *env.action_space.shape)).astype(np.float32)
        expected, got = dummy.step(actions), env.step(actions)
        for a, b in zip(expected[:3], got[:3], strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        for done, a, b in zip(got[2], expected[3], got[3], strict=True):
            assert b["TimeLimit.truncated"] == a["TimeLimit.truncated"]
            assert ("terminal_observation" in b) == done
            if not done:
                continue
            ends += 1
            faults += bool(b["fault"])
            np.testing.assert_array_equal(
                a.pop("terminal_observation"), b.pop("terminal_observation")
            )
            assert {name: a[name] for name in b} == b
            assert set(a) - set(b) == {"state", "time", "injected"}
        assert dummy.reset_infos == env.reset_infos
    assert ends > faults > 0
    dummy.close()
    env.close()


def test_seeds_and_options_are_used_once():
    env = sb3.make(ID, 2)
    env.seed(3)
    first = env.reset()
    assert (env.reset() != first).any()
    env.seed(3)
    np.testing.assert_array_equal(env.reset(), first)
    env.set_options({"start": 0.1, "goal": 0.3})
    env.reset()
    assert [env.reset_infos[i]["goal"] for i in (0, 1)] == [0.3, 0.3]
    env.reset()
    assert env.reset_infos[0]["goal"] != 0.3
    env.set_options([{"goal": 0.1}, {"goal": 0.2}])
    with pytest.raises(ValueError, match="give one dict"):
        env.reset()
    env.close()


def test_attributes_and_methods_are_those_of_the_chosen_environments():
    env = sb3.make(ID, 3)
    env.set_attr("tolerance", 0.01, indices=1)
    assert env.get_attr("tolerance") == [50e-6, 0.01, 50e-6]
    assert env.get_attr("tolerance", indices=[1]) == [0.01]
    assert not env.has_attr("no_such_thing")
    env.reset()
    assert list(env.env_method("ghosts", indices=2)[0]) == ["carriage"]
    assert env.env_is_wrapped(Monitor) == [False] * 3
    assert env.render_mode is None
    env.close()


def test_pictures_of_all_are_tiled():
    env = sb3.make(ID, 2, render_mode="rgb_array")
    env.reset()
    try:
        assert env.render().shape == (540 * 2, 960, 3)
    finally:
        env.close()


def test_another_autoreset_is_refused():
    vector = ServoVectorEnv(task(ID), 1)
    with pytest.raises(ValueError, match="autoreset_mode = 'NextStep'"):
        sb3.ServoVecEnv(vector)
    vector.close()


def test_an_unknown_id_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r"unknown environment 'Pole-v0'.*LinearAxis-v0"):
        sb3.make("Pole-v0")


def test_ppo_learns_on_it_with_the_wrappers_of_sb3():
    with sb3.one_thread():
        vector = sb3.make(ID, 4, max_episode_steps=25, following_error_window=1.0)
        env = VecNormalize(VecMonitor(vector))
        model = PPO("MlpPolicy", env, n_steps=32, batch_size=64, seed=1, device="cpu")
        model.learn(300)
    assert model.num_timesteps >= 300
    assert {entry["l"] for entry in model.ep_info_buffer} == {25}
    assert len(model.ep_success_buffer) == len(model.ep_info_buffer) >= 8
    _, lengths = evaluate_policy(model, env, 4, return_episode_rewards=True)
    assert lengths == [25] * 4
    env.close()
