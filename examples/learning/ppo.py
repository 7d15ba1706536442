"""PPO in one file, on many drives at once: nothing is hidden, and everything can be changed.

    python examples/learning/ppo.py --steps 400000 --seed 1 --out out/ppo

Proximal policy optimisation (Schulman et al. 2017) in the style of CleanRL: rollouts of a vector of
environments, advantages (GAE, Schulman et al. 2016), and some epochs of clipped gradients, repeated
until all steps are done. The hyper-parameters are those of `servogym train LinearAxis-v0`. It needs
`servogym[train]` for torch. With ``--device cuda`` environments, networks and data stay on a GPU.
``--device cpu`` does the same on a core, where mujoco-warp steps the physics (`servogym[gpu]`). The
folder gets `curve.csv`, `weights.npz` (arrays, nothing pickled) and `curve.png`.
"""

import argparse
import csv
import math
from dataclasses import dataclass, fields
from pathlib import Path

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn
from torch.distributions import Normal

FIXED = 20_000_000  # seed of the episodes of an evaluation: those of `servogym train`


@dataclass
class Arguments:
    """The options of the command line."""

    env: str = "LinearAxis-v0"
    steps: int = 400_000  # sum over all environments
    seed: int = 1
    out: str = "out/ppo"
    envs: int = 64
    rollout: int = 64  # steps of an environment between two updates
    batch: int = 512
    epochs: int = 5
    rate: float = 5e-4  # learning rate
    gamma: float = 0.98
    decay: float = 0.95  # lambda of the advantages
    clip: float = 0.2  # range of the ratio of probabilities
    value_weight: float = 0.5
    longest_gradient: float = 0.5
    log_std: float = -3.0  # initial value; near the goal there is no room for much noise
    evaluate: int = 50_000  # steps between two evaluations
    device: str = ""  # warp device of environments and networks; empty: the cores


def make(name: str, n: int, **arguments):
    """Make environments that reset in the step that ends an episode, with the previous action."""
    return gymnasium.make_vec(
        f"servogym.envs:servogym/{name}", n, vectorization_mode="vector_entry_point",
        autoreset_mode=AutoresetMode.SAME_STEP, previous_action=True, **arguments,
    )


def net(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    """Make a network with two hidden layers of 64, initialised orthogonally."""
    layers = [
        nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)
    ]
    for layer, scale in zip(layers[::2], (math.sqrt(2), math.sqrt(2), gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


class Agent(nn.Module):
    """Mean and standard deviation of the actions, and the value of an observation."""

    def __init__(self, inputs: int, actions: int, log_std: float):
        super().__init__()
        self.actor, self.critic = net(inputs, actions, 0.01), net(inputs, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((actions,), log_std))

    def policy(self, observation: torch.Tensor) -> Normal:
        return Normal(self.actor(observation), self.log_std.exp())

    def value(self, observation: torch.Tensor) -> torch.Tensor:
        return self.critic(observation)[..., 0]


class Running:
    """Running mean and variance of data (Chan, Golub, LeVeque 1979)."""

    def __init__(self, shape: tuple[int, ...] = (), device: torch.device | str = "cpu"):
        exact = {"dtype": torch.float64, "device": device}
        self.mean, self.variance = torch.zeros(shape, **exact), torch.ones(shape, **exact)
        self.count = 1e-4

    def update(self, batch: torch.Tensor) -> None:
        n, total = len(batch), self.count + len(batch)
        batch = batch.double()
        away = batch.mean(0) - self.mean
        squares = self.variance * self.count + batch.var(0, correction=0) * n
        self.variance = (squares + away**2 * self.count * n / total) / total
        self.mean, self.count = self.mean + away * n / total, total

    def __call__(self, observation: torch.Tensor) -> torch.Tensor:
        scaled = (observation - self.mean) / (self.variance + 1e-8).sqrt()
        return scaled.clip(-10.0, 10.0).float()


@torch.no_grad()
def evaluate(agent: Agent, scale: Running, envs) -> float:
    """Return the mean return of the fixed episodes on the cores, without exploration."""
    observation, _ = envs.reset(seed=FIXED)
    returns, active = np.zeros(envs.num_envs), np.ones(envs.num_envs, bool)
    while active.any():
        inputs = torch.as_tensor(observation, device=scale.mean.device)
        actions = agent.actor(scale(inputs)).clip(-1.0, 1.0).cpu().numpy()
        observation, rewards, ends, truncations, _ = envs.step(actions)
        returns += active * rewards
        active &= ~(ends | truncations)
    return float(returns.mean())


def train(given: Arguments) -> list[tuple[int, float]]:
    """Train an agent; -> steps and mean return of each evaluation."""
    torch.manual_seed(given.seed)
    torch.set_num_threads(1)  # for small networks a second thread costs more than it gains
    options = {"device": given.device} if given.device else {}
    envs, test_envs = make(given.env, given.envs, **options), make(given.env, 16)
    observation = torch.as_tensor(envs.reset(seed=given.seed)[0])
    device = observation.device  # of all tensors below
    (width,), (actions,) = envs.single_observation_space.shape, envs.single_action_space.shape
    agent = Agent(width, actions, given.log_std).to(device)
    optimiser = torch.optim.Adam(agent.parameters(), lr=given.rate, eps=1e-5)
    scale, earned = Running((width,), device), Running((), device)
    running = torch.zeros(given.envs, dtype=torch.float64, device=device)
    shape = given.rollout, given.envs
    observations = torch.zeros(*shape, width, device=device)
    actions_taken = torch.zeros(*shape, actions, device=device)
    log_probs, values, rewards_scaled, ended = (torch.zeros(shape, device=device) for _ in range(4))
    curve, done = [(0, evaluate(agent, scale, test_envs))], 0
    while done < given.steps:
        for t in range(given.rollout):
            scale.update(observation)
            observations[t] = scale(observation)
            with torch.no_grad():
                policy = agent.policy(observations[t])
                actions_taken[t] = policy.sample()
                log_probs[t] = policy.log_prob(actions_taken[t]).sum(-1)
                values[t] = agent.value(observations[t])
            *results, infos = envs.step(actions_taken[t].clip(-1, 1))
            observation, rewards, ends, truncations = (
                torch.as_tensor(result, device=device) for result in results
            )
            over = ends | truncations
            running = given.gamma * running + rewards
            earned.update(running)
            running[over] = 0.0
            rewards_scaled[t] = rewards / (earned.variance + 1e-8).sqrt()
            if truncations.any():  # the future of a truncated episode has a value
                last = torch.as_tensor(infos["final_obs"], device=device)[truncations]
                with torch.no_grad():
                    rewards_scaled[t, truncations] += given.gamma * agent.value(scale(last))
            ended[t] = over
        done += given.rollout * given.envs
        with torch.no_grad():
            following = agent.value(scale(observation))
        advantages, advantage = torch.zeros_like(values), torch.zeros_like(following)
        for t in reversed(range(given.rollout)):
            ongoing = 1.0 - ended[t]
            delta = rewards_scaled[t] + given.gamma * following * ongoing - values[t]
            advantage = delta + given.gamma * given.decay * ongoing * advantage
            advantages[t], following = advantage, values[t]
        update(agent, optimiser, given, [
            part.flatten(0, 1)
            for part in (observations, actions_taken, log_probs, advantages, advantages + values)
        ])
        if done // given.evaluate > (done - given.rollout * given.envs) // given.evaluate:
            curve.append((done, evaluate(agent, scale, test_envs)))
            print(f"{done} steps: {curve[-1][1]:.1f}", flush=True)
    envs.close()
    test_envs.close()
    save(Path(given.out), agent, scale, curve)
    return curve


def update(agent: Agent, optimiser, given: Arguments, data) -> None:
    """Run some epochs of gradient steps on the data of one rollout."""
    observations, actions, log_probs, advantages, returns = data
    for _ in range(given.epochs):
        drawn = torch.randperm(len(observations), device=observations.device)
        for rows in drawn.chunk(max(len(observations) // given.batch, 1)):
            policy = agent.policy(observations[rows])
            ratio = (policy.log_prob(actions[rows]).sum(-1) - log_probs[rows]).exp()
            gain = advantages[rows]
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            clipped = ratio.clip(1.0 - given.clip, 1.0 + given.clip)
            loss = -torch.min(gain * ratio, gain * clipped).mean()
            error = agent.value(observations[rows]) - returns[rows]
            loss += given.value_weight * (error**2).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), given.longest_gradient)
            optimiser.step()


def save(folder: Path, agent: Agent, scale: Running, curve: list[tuple[int, float]]) -> None:
    """Write the weights as arrays, and the curve as a table and a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    weights = {"mean": scale.mean, "variance": scale.variance, **agent.state_dict()}
    np.savez(
        folder / "weights.npz", **{name: tensor.cpu().numpy() for name, tensor in weights.items()}
    )
    with (folder / "curve.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("steps", "return"), *curve])
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    axes.plot(*zip(*curve, strict=True), "o-")
    axes.set_xlabel("steps")
    axes.set_ylabel("mean return of 16 fixed episodes")
    axes.grid(alpha=0.3)
    figure.savefig(folder / "curve.png", dpi=110)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    for field in fields(Arguments):
        parser.add_argument(f"--{field.name.replace('_', '-')}", type=field.type,
                            default=field.default)
    train(Arguments(**vars(parser.parse_args())))
