"""Behaviour cloning: a network learns to act as a demonstrated policy (Pomerleau 1989).

If random exploration never finds a reward, as in `Commissioning-v0`, an existing policy shows what
to do. The result is a checkpoint like any other, from which `--start` continues.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch

from ..policies.trained.residual import baseline, public
from .sb3 import ServoVecEnv

UPDATES, BATCH, RATE = 20_000, 512, 3e-3  # of the fit; the rate falls to 0 as a cosine
RARE = 20.0  # weight of a step close to a change of the action, against 1 while waiting
NEAR = 2  # steps after a change that count as close
# A set-point has to be right to a ten-thousandth, a bit only has to have the right sign. Components
# with more than two values in the demonstrations are therefore weighted by:
PRECISE = 10_000.0
CORRECTED = 1.0  # half the range of an action
NOISE = 0.2  # of the last action in an observation, so that small errors do not add up


class Shown(NamedTuple):
    """Demonstrations, one row per step."""

    observations: np.ndarray  # shape (steps, seen), float32
    actions: np.ndarray  # shape (steps, actions), float32
    weights: np.ndarray  # shape (steps,), with which a step is drawn


def demonstrated(env: ServoVecEnv, policy: str, steps: int, learner: Any = None) -> Shown:
    """Play a policy by name in all environments, at least `steps` steps in total.

    With a `learner`, a partly trained PPO, the learner's actions are played and the policy states
    the right ones (Ross et al. 2011). A component that is off by more than `CORRECTED` is replaced
    by the policy's, so that the policy never loses its place.

    Raises ValueError if the policy does not fit the task or gives no actions.
    """
    policies = [baseline(policy, one) for one in env.vector.envs]
    seen = np.asarray(env.reset())
    for i, one in enumerate(policies):
        one.reset(seen[i], public(env.reset_infos[i]))
    observations, actions, weights = [], [], []
    last = np.zeros((len(policies), env.action_space.shape[0]), np.float32)  # type: ignore[index]
    since = np.zeros(len(policies))  # steps since the action changed
    for _ in range(math.ceil(steps / len(policies))):
        given = np.stack([one.act(row) for one, row in zip(policies, seen, strict=True)])
        changed = (given != last).any(axis=1)
        since = np.where(changed, 0, since + 1)
        observations.append(seen.astype(np.float32))
        actions.append(given.astype(np.float32))
        weights.append(np.where(since <= NEAR, RARE, 1.0))
        last = given
        played = given if learner is None else _corrected(learner, seen, given)
        observation, _, done, _ = env.step(played)
        seen = np.asarray(observation)
        for i in np.flatnonzero(done).tolist():
            policies[i].reset(seen[i], public(env.reset_infos[i]))
            last[i] = 0.0
    return Shown(np.concatenate(observations), np.concatenate(actions), np.concatenate(weights))


def _corrected(learner: Any, seen: np.ndarray, right: np.ndarray) -> np.ndarray:
    statistics = learner.get_vec_normalize_env()
    rows = seen if statistics is None else statistics.normalize_obs(seen)
    own = learner.predict(rows, deterministic=True)[0]
    return np.where(np.abs(own - right) < CORRECTED, own, right)


def learn(
    model: Any, policy: str, steps: int, seed: int, *, previous_action: bool
) -> Iterator[None]:
    """Learn from steps that the policy plays, then from as many in which it corrects the learner.

    Yields after each half.

    Args:
        model: PPO of stable-baselines3, with its environments.
        policy: by name.
        steps: of all environments together.
        seed: of the rows that are drawn, and of the noise.
        previous_action: whether an observation ends with the last action.
    """
    env = model.get_env().unwrapped
    first = demonstrated(env, policy, steps - steps // 2)
    if (statistics := model.get_vec_normalize_env()) is not None:
        statistics.obs_rms.update(first.observations.astype(float))
    fit(model, first, seed, previous_action=previous_action)
    model.num_timesteps = len(first.weights)
    yield
    second = demonstrated(env, policy, steps // 2, model)
    both = Shown(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))
    fit(model, both, seed, previous_action=previous_action)
    model.num_timesteps = len(both.weights)
    yield


def fit(model: Any, shown: Shown, seed: int, *, previous_action: bool) -> None:
    """Fit the mean action of PPO's policy to demonstrations.

    Args:
        model: PPO of stable-baselines3, with its environments.
        shown: the demonstrations.
        seed: of the rows that are drawn, and of the noise.
        previous_action: whether an observation ends with the last action.
    """
    statistics = model.get_vec_normalize_env()
    precise = np.array([len(np.unique(column)) > 2 for column in shown.actions.T])
    weights = torch.from_numpy(np.where(precise, PRECISE, 1.0).astype(np.float32))
    network = model.policy
    parameters = [*network.mlp_extractor.policy_net.parameters(), *network.action_net.parameters()]
    optimizer = torch.optim.Adam(parameters, RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, UPDATES)
    random = np.random.default_rng(seed)
    share = np.cumsum(shown.weights)
    for _ in range(UPDATES):
        rows = np.searchsorted(share, share[-1] * random.random(BATCH), side="right")
        seen, wanted = shown.observations[rows], shown.actions[rows]
        if previous_action:
            own = seen[:, -wanted.shape[1] :]
            own += NOISE * random.standard_normal(own.shape, np.float32)
            own[:, precise] = random.uniform(-1.0, 1.0, (len(own), int(precise.sum())))
            np.clip(own, -1.0, 1.0, out=own)
        if statistics is not None:
            seen = statistics.normalize_obs(seen)
        hidden = network.mlp_extractor.forward_actor(torch.from_numpy(seen.astype(np.float32)))
        off = network.action_net(hidden) - torch.from_numpy(wanted)
        loss = (off * off * weights).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
