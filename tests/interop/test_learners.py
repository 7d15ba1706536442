"""Libraries of learning as they come from PyPI, each a training of some thousand steps on ours.

On an environment, and on a vector of ours where the library takes one. None is among our extras,
and none of this is part of `make test`: in an environment of its own, with this package and the
library, `pytest -m interop tests/interop/test_learners.py -rs`. docs/how-to/train.md has the
versions.
"""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import servogym.envs  # noqa: F401, registers
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.envs.tasks.positioning import LinearAxisEnv

pytestmark = [pytest.mark.interop, pytest.mark.filterwarnings("default")]

ID = "servogym/LinearAxis-v0"
STEPS = 4096


def library(name):
    """Or skip: also where another library of this file has brought half of it."""
    return pytest.importorskip(
        name, reason=f"needs {name}, which is not among our extras", exc_type=ImportError
    )


def one(**arguments):
    return gym.make(ID, disable_env_checker=True, **arguments)


def many(n=4):
    return ServoVectorEnv(LinearAxisEnv, n, autoreset_mode="SameStep")


def weights(module):
    return {name: value.detach().clone() for name, value in module.state_dict().items()}


def has_learned(before, module):
    """Whether weights have changed, and all are numbers."""
    after = module.state_dict()
    assert all(value.isfinite().all() for value in after.values())
    return any((before[name] != value).any() for name, value in after.items())


def test_torchrl_makes_an_environment_by_its_id():
    """It tries arguments that no environment of ours has, and reads the TypeError."""
    taken = library("torchrl.envs.libs.gym").GymEnv(ID).rollout(5)
    assert taken["next", "reward"].shape == (5, 1)


@pytest.mark.parametrize("vector", [False, True])
def test_torchrl_trains_with_ppo(vector):
    collectors, wrappers = library("torchrl.collectors"), library("torchrl.envs.libs.gym")
    import torch
    from tensordict.nn import TensorDictModule
    from torchrl.modules import (
        MLP,
        NormalParamExtractor,
        ProbabilisticActor,
        TanhNormal,
        ValueOperator,
    )
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value import GAE

    torch.manual_seed(1)
    env = wrappers.GymWrapper(many() if vector else one())
    net = torch.nn.Sequential(
        MLP(in_features=7, out_features=2, num_cells=[32]), NormalParamExtractor()
    )
    actor = ProbabilisticActor(
        TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"], distribution_class=TanhNormal, return_log_prob=True,
    )
    critic = ValueOperator(MLP(in_features=7, out_features=1, num_cells=[32]), ["observation"])
    loss, advantage = ClipPPOLoss(actor, critic), GAE(gamma=0.98, lmbda=0.95, value_network=critic)
    optimizer = torch.optim.Adam(loss.parameters(), 3e-4)
    before, seen = weights(net), 0
    for batch in collectors.Collector(
        env, actor, frames_per_batch=1024, total_frames=STEPS, trust_policy=True
    ):
        advantage(batch)
        for part in batch.reshape(-1).split(256):
            losses = loss(part)
            total = losses["loss_objective"] + losses["loss_entropy"] + losses["loss_critic"]
            optimizer.zero_grad()
            total.backward()
            optimizer.step()
        seen += batch.numel()
    assert seen == STEPS
    assert has_learned(before, net)


@pytest.mark.parametrize("workers", ["DummyVectorEnv", "SubprocVectorEnv"])
def test_tianshou_trains_with_ppo(workers):
    """On vectors of its own; it takes none of Gymnasium's."""
    library("tianshou")
    import tianshou.env
    import torch
    from tianshou.algorithm import PPO
    from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
    from tianshou.algorithm.optim import AdamOptimizerFactory
    from tianshou.data import Collector, VectorReplayBuffer
    from tianshou.trainer import OnPolicyTrainerParams
    from tianshou.utils.net.common import Net
    from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic

    torch.manual_seed(1)
    envs = getattr(tianshou.env, workers)([one for _ in range(4)])
    space = one().action_space
    actor = ContinuousActorProbabilistic(
        preprocess_net=Net(state_shape=7, hidden_sizes=[32]), action_shape=1, unbounded=True
    )
    policy = ProbabilisticActorPolicy(
        actor=actor, action_space=space,
        dist_fn=lambda told: torch.distributions.Independent(torch.distributions.Normal(*told), 1),
    )
    critic = ContinuousCritic(preprocess_net=Net(state_shape=7, hidden_sizes=[32]))
    algorithm = PPO(policy=policy, critic=critic, optim=AdamOptimizerFactory(lr=3e-4))
    before = weights(actor)
    found = algorithm.run_training(
        OnPolicyTrainerParams(
            training_collector=Collector(algorithm, envs, VectorReplayBuffer(STEPS, 4)),
            max_epochs=2, epoch_num_steps=STEPS // 2, collection_step_num_env_steps=1024,
            update_step_num_repetitions=2, batch_size=256, test_in_training=False, verbose=False,
            show_progress=False,
        )
    )
    envs.close()
    assert found.train_step == STEPS
    assert has_learned(before, actor)


@pytest.mark.parametrize("vector", [False, True])
@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_sbx_trains(algorithm, vector):
    sbx = library("sbx")
    from servogym.training.learn.sb3 import make

    envs = make("LinearAxis-v0", 4) if vector else one()
    arguments = {"PPO": {"n_steps": 256}, "SAC": {"learning_starts": 256, "train_freq": 16}}
    model = getattr(sbx, algorithm)("MlpPolicy", envs, seed=1, **arguments[algorithm])
    watched = np.zeros((1, 7), np.float32)
    before = model.predict(watched, deterministic=True)[0]
    model.learn(STEPS)
    after = model.predict(watched, deterministic=True)[0]
    assert model.num_timesteps >= STEPS
    assert np.isfinite(after).all()
    assert (before != after).any()


@pytest.mark.parametrize("mode", ["sync", "vector_entry_point"])
def test_rllib_trains_with_ppo(mode):
    library("ray.rllib")
    from ray.rllib.algorithms.ppo import PPOConfig

    config = PPOConfig().environment("servogym.envs:" + ID)
    config = config.env_runners(
        num_env_runners=0, num_envs_per_env_runner=4, gym_env_vectorize_mode=mode
    )
    config = config.training(
        train_batch_size_per_learner=STEPS // 2, minibatch_size=256, num_epochs=2
    )
    algorithm = config.build_algo()
    before = weights(algorithm.get_module())
    found = [algorithm.train() for _ in range(2)][-1]
    learned = has_learned(before, algorithm.get_module())
    algorithm.stop()
    assert found["num_env_steps_sampled_lifetime"] >= STEPS
    assert np.isfinite(found["env_runners"]["episode_return_mean"])
    assert learned


def as_cleanrl(idx):
    """`make_env` of its ppo_continuous_action.py."""

    def thunk():
        env = gym.make(ID)
        env = gym.wrappers.FlattenObservation(env)
        env = gym.wrappers.RecordEpisodeStatistics(env)
        env = gym.wrappers.ClipAction(env)
        env = gym.wrappers.NormalizeObservation(env)
        env = gym.wrappers.TransformObservation(
            env, lambda seen: np.clip(seen, -10, 10), env.observation_space
        )
        env = gym.wrappers.NormalizeReward(env, gamma=0.99)
        return gym.wrappers.TransformReward(env, lambda reward: np.clip(reward, -10, 10))

    return thunk


@pytest.mark.parametrize("kind", ["sync", "async", "ours"])
def test_a_script_in_the_habit_of_cleanrl_trains(kind):
    """Rollouts, advantages, clipped gradients; its episodes are in the infos."""
    torch = library("torch")
    if kind == "ours":
        envs = gym.make_vec(
            ID, 4, vectorization_mode="vector_entry_point", autoreset_mode=AutoresetMode.SAME_STEP
        )
        envs = gym.wrappers.vector.RecordEpisodeStatistics(envs)
    else:
        vector = gym.vector.SyncVectorEnv if kind == "sync" else gym.vector.AsyncVectorEnv
        envs = vector([as_cleanrl(i) for i in range(4)], autoreset_mode=AutoresetMode.SAME_STEP)
    torch.manual_seed(1)
    actor = torch.nn.Sequential(torch.nn.Linear(7, 32), torch.nn.Tanh(), torch.nn.Linear(32, 1))
    critic = torch.nn.Sequential(torch.nn.Linear(7, 32), torch.nn.Tanh(), torch.nn.Linear(32, 1))
    spread = torch.nn.Parameter(torch.zeros(1))
    both = [*actor.parameters(), *critic.parameters(), spread]
    optimizer, before = torch.optim.Adam(both, 3e-4), weights(actor)
    seen, _ = envs.reset(seed=1)
    returns, length = [], 256
    for _ in range(STEPS // (4 * length)):
        rollout = []
        for _ in range(length):
            state = torch.as_tensor(seen, dtype=torch.float32)
            with torch.no_grad():
                normal = torch.distributions.Normal(actor(state), spread.exp())
                action = normal.sample()
                kept = normal.log_prob(action).sum(1), critic(state)[:, 0]
            seen, reward, ended, cut, infos = envs.step(action.numpy().clip(-1, 1))
            done = torch.as_tensor(ended | cut, dtype=torch.float32)
            rollout.append((state, action, *kept, torch.as_tensor(reward).float(), done))
            # Gymnasium's wrapper of a vector has them beside, that of an environment within
            found = infos.get("episode", infos.get("final_info", {}).get("episode"))
            if found is not None:
                returns += found["r"][ended | cut].tolist()
        states, actions, old, values, rewards, dones = map(torch.stack, zip(*rollout, strict=True))
        with torch.no_grad():
            after = critic(torch.as_tensor(seen, dtype=torch.float32))[:, 0]
        advantages, last = torch.zeros_like(rewards), torch.zeros(4)
        for t in reversed(range(length)):
            following = after if t == length - 1 else values[t + 1]
            delta = rewards[t] + 0.99 * following * (1 - dones[t]) - values[t]
            advantages[t] = last = delta + 0.99 * 0.95 * (1 - dones[t]) * last
        for _ in range(2):
            normal = torch.distributions.Normal(actor(states), spread.exp())
            ratio = (normal.log_prob(actions).sum(2) - old).exp()
            gain = torch.minimum(ratio * advantages, ratio.clip(0.8, 1.2) * advantages).mean()
            miss = ((critic(states)[:, :, 0] - values - advantages) ** 2).mean()
            optimizer.zero_grad()
            (0.5 * miss - gain).backward()
            optimizer.step()
    envs.close()
    assert len(returns) >= STEPS // 200 - 4
    assert all(0.0 <= value <= 200.0 for value in returns)
    assert has_learned(before, actor)
