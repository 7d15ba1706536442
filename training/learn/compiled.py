"""PPO of stable-baselines3 with its arithmetic compiled: the same formulas, in a fifth of the time.

What is learned differs from SB3's own update by the rounding of float32. Where the settings ask for
more than `gradient` knows, and with ``NUMBA_DISABLE_JIT=1``, it is SB3's own.
"""

from typing import Any, ClassVar

import numpy as np

from ..policies.trained.saved import stable_baselines3
from .gradient import HALF_LOG_TAU, LOSSES, SETTINGS, tell, update

stable_baselines3()  # tells what has to be installed

# isort: split
import torch  # noqa: E402
from stable_baselines3 import PPO  # noqa: E402
from stable_baselines3.common.distributions import DiagGaussianDistribution  # noqa: E402
from stable_baselines3.common.policies import ActorCriticPolicy  # noqa: E402
from stable_baselines3.common.utils import explained_variance  # noqa: E402

from ...drive.kernel.jit import DISABLED  # noqa: E402


class CompiledPolicy(ActorCriticPolicy):
    """The policy of SB3, which acts in rollouts by compiled code."""

    def networks(self) -> tuple[list[torch.nn.Parameter], np.ndarray, np.ndarray]:
        """All parameters in the order of `gradient`, and the widths of actor and critic."""
        actor = _linear(*self.mlp_extractor.policy_net, self.action_net)
        critic = _linear(*self.mlp_extractor.value_net, self.value_net)
        parameters = [self.log_std]
        for layer in (*actor, *critic):
            parameters += [layer.weight, layer.bias]
        return parameters, _widths(actor), _widths(critic)

    def plain(self) -> bool:
        """Whether the networks are what `gradient` knows."""
        group = self.optimizer.param_groups[0]
        return (
            not DISABLED
            and isinstance(self.action_dist, DiagGaussianDistribution)
            and self.activation_fn is torch.nn.Tanh
            and isinstance(self.optimizer, torch.optim.Adam)
            and not (group["weight_decay"] or group["amsgrad"])
        )

    def forward(self, obs, deterministic: bool = False):
        """Actions, values and logarithms of chances, of what is seen."""
        if deterministic or not self.plain():
            return super().forward(obs, deterministic)
        parameters, actor, critic = self.networks()
        seen = np.ascontiguousarray(obs.numpy(), np.float32)
        means = np.empty((len(seen), actor[-1]), np.float32)
        values = np.empty(len(seen), np.float32)
        tell(_flat(parameters), actor, critic, seen, means, values)
        spread = self.log_std.detach().numpy()
        noise = torch.randn(means.shape).numpy()
        actions = means + np.exp(spread) * noise
        chances = -(0.5 * noise**2 + spread + HALF_LOG_TAU).sum(axis=1)
        return torch.from_numpy(actions), torch.from_numpy(values), torch.from_numpy(chances)


class CompiledPPO(PPO):
    """PPO that acts and updates by compiled code."""

    policy: CompiledPolicy
    policy_aliases: ClassVar[dict[str, Any]] = {"MlpPolicy": CompiledPolicy}

    def _plain(self) -> bool:
        return (
            self.policy.plain()
            and self.normalize_advantage
            and self.clip_range_vf is None
            and self.target_kl is None
        )

    def train(self) -> None:
        """Learn from the rollout."""
        if not self._plain():
            super().train()
            return
        self._update_learning_rate(self.policy.optimizer)
        group, buffer = self.policy.optimizer.param_groups[0], self.rollout_buffer
        clip = self.clip_range(self._current_progress_remaining)  # type: ignore[operator]
        given = np.array((
            self.batch_size, group["lr"], *group["betas"], group["eps"], self.max_grad_norm,
            clip, self.ent_coef, self.vf_coef,
        ), SETTINGS)  # fmt: skip
        parameters, actor, critic = self.policy.networks()
        numbers, (first, second, count) = _flat(parameters), self._moments(parameters)
        n = buffer.values.size
        # of the generator that `set_random_seed` of SB3 seeds
        orders = np.array([np.random.permutation(n) for _ in range(self.n_epochs)])  # noqa: NPY002
        losses = np.zeros(self.n_epochs * -(-n // self.batch_size), LOSSES)
        update(
            numbers, first, second, count, actor, critic,
            buffer.observations.reshape(n, -1), buffer.actions.reshape(n, -1),
            *(part.reshape(n) for part in (buffer.log_probs, buffer.advantages, buffer.returns)),
            orders, given[()], losses,
        )  # fmt: skip
        self._put(parameters, numbers, first, second, count + len(losses))
        self._n_updates += self.n_epochs
        self._tell(losses, clip)

    def _moments(self, parameters) -> tuple[np.ndarray, np.ndarray, int]:
        """Of Adam, as torch keeps them."""
        state = self.policy.optimizer.state
        if not state:
            size = sum(parameter.numel() for parameter in parameters)
            return np.zeros(size, np.float32), np.zeros(size, np.float32), 0
        kept = [state[parameter] for parameter in parameters]
        first, second = (_flat([of[name] for of in kept]) for name in ("exp_avg", "exp_avg_sq"))
        return first, second, int(kept[0]["step"])

    def _put(self, parameters, numbers, first, second, count: int) -> None:
        """Back into torch's parameters and optimizer."""
        begin = 0
        for parameter in parameters:
            part = slice(begin, begin + parameter.numel())
            begin = part.stop
            parameter.data.copy_(torch.from_numpy(numbers[part]).view_as(parameter))
            self.policy.optimizer.state[parameter] = {
                "step": torch.tensor(float(count)),
                "exp_avg": torch.from_numpy(first[part]).view_as(parameter),
                "exp_avg_sq": torch.from_numpy(second[part]).view_as(parameter),
            }

    def _tell(self, losses: np.ndarray, clip: float) -> None:
        """What SB3's update logs."""
        spread = self.policy.log_std.detach().numpy()
        entropy = -float((0.5 + HALF_LOG_TAU + spread).sum())
        policy, value = losses["policy"], losses["value"]
        last = policy[-1] + self.ent_coef * entropy + self.vf_coef * value[-1]
        buffer, batches = self.rollout_buffer, len(losses) // self.n_epochs
        for name, number in (
            ("entropy_loss", entropy),
            ("policy_gradient_loss", policy.mean()),
            ("value_loss", value.mean()),
            ("approx_kl", losses["divergence"][-batches:].mean()),
            ("clip_fraction", losses["clipped"].mean()),
            ("loss", last),
            (
                "explained_variance",
                explained_variance(buffer.values.ravel(), buffer.returns.ravel()),
            ),
            ("std", np.exp(spread).mean()),
            ("clip_range", clip),
        ):
            self.logger.record(f"train/{name}", float(number))
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")


def _linear(*modules: torch.nn.Module) -> list[torch.nn.Linear]:
    return [module for module in modules if isinstance(module, torch.nn.Linear)]


def _widths(layers: list[torch.nn.Linear]) -> np.ndarray:
    return np.array([layers[0].in_features, *(layer.out_features for layer in layers)])


def _flat(tensors) -> np.ndarray:
    """Their numbers in one array, a copy."""
    return np.concatenate([tensor.detach().numpy().ravel() for tensor in tensors])
