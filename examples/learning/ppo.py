"""PPO in one file, on many drives at once: nothing is hidden, everything may be changed.

    python examples/learning/ppo.py --steps 400000 --seed 1 --out out/ppo

Proximal policy optimisation (Schulman et al. 2017) as CleanRL writes it: rollouts of a vector of
environments, advantages (GAE, Schulman et al. 2016), some epochs of clipped gradients, and again.
The hyper-parameters are those of `servogym train LinearAxis-v0`. Needs `servogym[train]` for torch.
With ``--device cuda`` environments, nets and all that is learned from stay on a GPU; so does
``--device cpu``, to try it, where mujoco-warp steps on a core (`servogym[gpu]`).
The folder gets `curve.csv`, `weights.npz` (arrays, nothing pickled) and `curve.png`.
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
    """Each is an option of the command line."""

    env: str = "LinearAxis-v0"
    steps: int = 400_000  # of all environments together
    seed: int = 1
    out: str = "out/ppo"
    envs: int = 64
    rollout: int = 64  # steps of an environment between two updates
    batch: int = 512
    epochs: int = 5
    rate: float = 5e-4  # of learning
    gamma: float = 0.98
    decay: float = 0.95  # lambda of the advantages
    clip: float = 0.2  # of the ratio of probabilities
    value_weight: float = 0.5
    longest_gradient: float = 0.5
    log_std: float = -3.0  # at first; at rest within the tolerance there is no room for noise
    evaluate: int = 50_000  # steps between two evaluations
    device: str = ""  # of warp, for environments and nets; none: the cores


def make(name: str, n: int, **arguments):
    """Environments that begin anew in the step that ends an episode; they see their last action."""
    return gymnasium.make_vec(
        f"servogym.envs:servogym/{name}", n, vectorization_mode="vector_entry_point",
        autoreset_mode=AutoresetMode.SAME_STEP, previous_action=True, **arguments,
    )


def net(seen: int, told: int, gain: float) -> nn.Sequential:
    """Two hidden layers of 64, initialised orthogonally."""
    layers = [nn.Linear(seen, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, told)]
    for layer, scale in zip(layers[::2], (math.sqrt(2), math.sqrt(2), gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


class Agent(nn.Module):
    """Mean and standard deviation of the actions, and the value of what is seen."""

    def __init__(self, seen: int, actions: int, log_std: float):
        super().__init__()
        self.actor, self.critic = net(seen, actions, 0.01), net(seen, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((actions,), log_std))

    def policy(self, seen: torch.Tensor) -> Normal:
        return Normal(self.actor(seen), self.log_std.exp())

    def value(self, seen: torch.Tensor) -> torch.Tensor:
        return self.critic(seen)[..., 0]


class Running:
    """Mean and variance of all that has been seen (Chan, Golub, LeVeque 1979)."""

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

    def __call__(self, seen: torch.Tensor) -> torch.Tensor:
        scaled = (seen - self.mean) / (self.variance + 1e-8).sqrt()
        return scaled.clip(-10.0, 10.0).float()


@torch.no_grad()
def evaluate(agent: Agent, scale: Running, envs) -> float:
    """Mean return of the fixed episodes, without exploration; they are on the cores."""
    seen, _ = envs.reset(seed=FIXED)
    returns, active = np.zeros(envs.num_envs), np.ones(envs.num_envs, bool)
    while active.any():
        there = torch.as_tensor(seen, device=scale.mean.device)
        actions = agent.actor(scale(there)).clip(-1.0, 1.0).cpu().numpy()
        seen, rewards, ends, truncations, _ = envs.step(actions)
        returns += active * rewards
        active &= ~(ends | truncations)
    return float(returns.mean())


def train(given: Arguments) -> list[tuple[int, float]]:
    """-> steps and mean return of each evaluation."""
    torch.manual_seed(given.seed)
    torch.set_num_threads(1)  # with nets this small, a second one costs more than it brings
    on = {"device": given.device} if given.device else {}
    envs, judged = make(given.env, given.envs, **on), make(given.env, 16)
    seen = torch.as_tensor(envs.reset(seed=given.seed)[0])
    device = seen.device  # all below is there
    (width,), (actions,) = envs.single_observation_space.shape, envs.single_action_space.shape
    agent = Agent(width, actions, given.log_std).to(device)
    optimiser = torch.optim.Adam(agent.parameters(), lr=given.rate, eps=1e-5)
    scale, earned = Running((width,), device), Running((), device)
    running = torch.zeros(given.envs, dtype=torch.float64, device=device)
    shape = given.rollout, given.envs
    seen_all = torch.zeros(*shape, width, device=device)
    actions_all = torch.zeros(*shape, actions, device=device)
    chances, values, rewards_all, ends_all = (torch.zeros(shape, device=device) for _ in range(4))
    curve, done = [(0, evaluate(agent, scale, judged))], 0
    while done < given.steps:
        for t in range(given.rollout):
            scale.update(seen)
            seen_all[t] = scale(seen)
            with torch.no_grad():
                policy = agent.policy(seen_all[t])
                actions_all[t] = policy.sample()
                chances[t] = policy.log_prob(actions_all[t]).sum(-1)
                values[t] = agent.value(seen_all[t])
            *told, infos = envs.step(actions_all[t].clip(-1, 1))
            seen, rewards, ends, truncations = (torch.as_tensor(x, device=device) for x in told)
            over = ends | truncations
            running = given.gamma * running + rewards
            earned.update(running)
            running[over] = 0.0
            rewards_all[t] = rewards / (earned.variance + 1e-8).sqrt()
            if truncations.any():  # time is up, but what would have followed has a value
                last = torch.as_tensor(infos["final_obs"], device=device)[truncations]
                with torch.no_grad():
                    rewards_all[t, truncations] += given.gamma * agent.value(scale(last))
            ends_all[t] = over
        done += given.rollout * given.envs
        with torch.no_grad():
            following = agent.value(scale(seen))
        advantages, advantage = torch.zeros_like(values), torch.zeros_like(following)
        for t in reversed(range(given.rollout)):
            on = 1.0 - ends_all[t]
            surprise = rewards_all[t] + given.gamma * following * on - values[t]
            advantage = surprise + given.gamma * given.decay * on * advantage
            advantages[t], following = advantage, values[t]
        update(agent, optimiser, given, [
            part.flatten(0, 1)
            for part in (seen_all, actions_all, chances, advantages, advantages + values)
        ])
        if done // given.evaluate > (done - given.rollout * given.envs) // given.evaluate:
            curve.append((done, evaluate(agent, scale, judged)))
            print(f"{done} steps: {curve[-1][1]:.1f}", flush=True)
    envs.close()
    judged.close()
    keep(Path(given.out), agent, scale, curve)
    return curve


def update(agent: Agent, optimiser, given: Arguments, data) -> None:
    """Some epochs of gradients on what one rollout has brought."""
    seen, actions, chances, advantages, returns = data
    for _ in range(given.epochs):
        drawn = torch.randperm(len(seen), device=seen.device)
        for rows in drawn.chunk(max(len(seen) // given.batch, 1)):
            policy = agent.policy(seen[rows])
            ratio = (policy.log_prob(actions[rows]).sum(-1) - chances[rows]).exp()
            gain = advantages[rows]
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            clipped = ratio.clip(1.0 - given.clip, 1.0 + given.clip)
            loss = -torch.min(gain * ratio, gain * clipped).mean()
            loss += given.value_weight * ((agent.value(seen[rows]) - returns[rows]) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), given.longest_gradient)
            optimiser.step()


def keep(folder: Path, agent: Agent, scale: Running, curve: list[tuple[int, float]]) -> None:
    """Weights as arrays, the curve as a table and as a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    kept = {"mean": scale.mean, "variance": scale.variance, **agent.state_dict()}
    np.savez(
        folder / "weights.npz", **{name: tensor.cpu().numpy() for name, tensor in kept.items()}
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
