"""The tasks of gantries: what holds for each of them."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import servogym.envs
from servogym.drive.kernel.words import Mode
from servogym.drive.model.model import load, model_names
from servogym.envs import tasks
from servogym.envs.environment.vector_env import ServoVectorEnv

assert servogym.envs
TASKS = [task for task in tasks.TASKS if task.ID.startswith("servogym/Gantry")]
ABLE = [name for name in model_names() if Mode.CYCLIC_SYNC_POSITION in load(name).modes]
task = pytest.mark.parametrize("task", TASKS, ids=lambda task: task.__name__)


def gentle(generator, env, steps):
    return generator.uniform(-0.3, 0.3, (steps, *env.action_space.shape)).astype(np.float32)


@task
@pytest.mark.parametrize("face", ["setpoint", "pdo"])
@pytest.mark.parametrize("model", ABLE)
def test_gymnasium_checker_is_content(task, model, face):
    check_env(task(drive=model, action=face), skip_render_check=True)


@task
@pytest.mark.parametrize("model", sorted(set(model_names()) - set(ABLE)))
def test_a_drive_without_the_mode_is_refused_by_it(task, model):
    with pytest.raises(ValueError, match="has no mode cyclic_sync_position"):
        task(drive=model)


@task
def test_drives_are_enabled_in_the_mode_of_the_task_but_not_for_an_agent_of_pdos(task):
    for face, state in (("setpoint", "OPERATION_ENABLED"), ("pdo", "SWITCH_ON_DISABLED")):
        env = task(action=face)
        env.reset(seed=1)
        assert env.info()["state"] == state
        assert all(drive.axis.homed for drive in env.drives)
        env.step(np.zeros(env.action_space.shape))
        assert env.info()["state"] == state


@task
def test_an_agent_of_pdos_walks_to_operation_enabled(task):
    env = task(action="pdo")
    env.reset(seed=1)
    action = np.zeros(env.action_space.shape)
    for word in (0x06, 0x07, 0x0F):
        for d in range(len(env.drives)):
            at = task_actions(env) + 10 * d
            action[at : at + 9] = [1.0 if word >> bit & 1 else -1.0 for bit in range(9)]
            action[at + 9] = -1.0  # the first mode, that of the task
        *_, terminated, _, info = env.step(action)
        assert not terminated
    assert info["state"] == "OPERATION_ENABLED"


def task_actions(env):
    return env.action_space.shape[0] - 10 * len(env.drives)


@task
def test_a_vector_is_bit_for_bit_the_environments_one_by_one(task):
    peers = [task() for _ in range(3)]
    vector = ServoVectorEnv(task, 3, threads=2)
    seen, _ = vector.reset(seed=7)
    for i, env in enumerate(peers):
        np.testing.assert_array_equal(env.reset(seed=7 + i)[0], seen[i])
    for action in gentle(np.random.default_rng(1), vector, 40):
        seen, rewards, *_, infos = vector.step(action)
        for i, env in enumerate(peers):
            observation, reward, _, _, info = env.step(action[i])
            np.testing.assert_array_equal(observation, seen[i])
            assert reward == rewards[i]
            assert 0.0 <= reward <= 1.0
            for name in info:
                if name.startswith("reward_"):
                    assert info[name] == infos[name][i]
                    assert 0.0 <= info[name] <= 1.0
    vector.close()


@task
def test_one_seed_one_rollout_whatever_was_before(task):
    def rollout(env):
        seen = [env.reset(seed=3)[0]]
        for action in gentle(np.random.default_rng(2), env, 30):
            observation, reward, *_ = env.step(action)
            seen.append(np.append(observation, reward))
        return np.concatenate(seen).tobytes()

    fresh, used = task(), task()
    for seed in (8, 9):
        used.reset(seed=seed)
        used.step(np.full(used.action_space.shape, 0.5))
    assert rollout(fresh) == rollout(used)


@task
def test_a_pickled_environment_goes_on_bit_for_bit(task):
    env = task(history=2)
    env.reset(seed=11)
    actions = gentle(np.random.default_rng(2), env, 40)
    for action in actions[:20]:
        env.step(action)
    again = pickle.loads(pickle.dumps(env))
    for action in actions[20:]:
        one, other = env.step(action), again.step(action)
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1:] == other[1:]
    np.testing.assert_array_equal(env.reset()[0], again.reset()[0])


@task
def test_a_fault_of_any_drive_terminates_with_its_code(task):
    for number in range(len(task().drives)):
        env = task()
        env.reset(seed=1)
        env.drives[number].inject("encoder_loss")
        for _ in range(5):
            *_, terminated, _, info = env.step(np.zeros(env.action_space.shape))
        assert terminated
        assert info["fault"].startswith("7305h")
        if len(env.drives) > 1:
            assert info["fault"].endswith(f"({[*(env.DRIVES or env.machine.drives)][number]})")


@task
def test_a_registered_task_can_be_made_and_is_truncated_after_its_steps(task):
    env = gym.make("servogym.envs:" + task.ID)
    env.reset(seed=1)
    steps, over = 0, False
    while not over:
        *_, terminated, over, _ = env.step(np.zeros(env.action_space.shape, np.float32))
        assert not terminated
        steps += 1
    assert steps == task.STEPS


@task
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tolerance": float("nan")}, r"tolerance = nan is out of range .* m"),
        ({"following_error_window": 0.0}, "following_error_window = 0.0"),
        ({"randomise": {"payload": (0.0, 1.0)}}, "randomise"),
        ({"randomise": {"stifness": 1.0}}, "unknown name 'stifness'"),
        ({"drive": "acme"}, "unknown drive model"),
    ],
)
def test_wrong_arguments_are_named(task, arguments, message):
    with pytest.raises(ValueError, match=message):
        task(**arguments)


@task
def test_a_start_out_of_the_stroke_is_named(task):
    with pytest.raises(ValueError, match=r"options\['start'\]"):
        task().reset(options={"start": 7.0})
