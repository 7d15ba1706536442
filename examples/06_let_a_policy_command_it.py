# %% [markdown]
# # 6 · Let a policy command it
#
# Here the same drive is part of a Gymnasium environment, `servogym/LinearAxis-v0`: bring the
# carriage to a goal and hold it there. A policy observes the TPDOs of the drive and moves the
# target position in its RPDO. This lesson compares a hand-written policy with random actions.
#
# A learned policy uses the same two spaces: any library for Gymnasium environments can train it,
# with `gymnasium.make_vec` for speed. `pip install 'servogym[train]'`
# brings Stable-Baselines3, for `servogym train LinearAxis-v0`.

# %%
import sys
from pathlib import Path

import gymnasium
import matplotlib.pyplot as plt
import numpy as np

picture = Path(
    next((a for a in sys.argv if a.endswith(".png")), "out/06_let_a_policy_command_it.png")
)
env = gymnasium.make("servogym.envs:servogym/LinearAxis-v0", drive="generic", payload=5.0)
print(env.observation_space, env.action_space)

# %% [markdown]
# The action is the velocity of the set-point, 1.0 is 607Fh = 2 m/s. Observation 0 is the distance
# to the goal in strokes of 0.5 m, observation 5 is the lead of the set-point over the carriage in
# windows of 20 mm. Their difference is the remaining distance of the set-point. The policy brakes
# along the parabola v² = 2 a s and only stores its last velocity, to limit the acceleration.

# %%
STROKE, WINDOW, MAX_VELOCITY, STEP = 0.5, 0.02, 2.0, 5e-3  # m, m, m/s, s
ACCELERATION = 8.0  # m/s², less than the motor can do


class Braking:
    """Accelerates, travels at 1 m/s at most, and brakes in time."""

    def __init__(self):
        self.velocity = 0.0  # of the set-point (m/s)

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        named = env.unwrapped.named(observation)  # with the names in the docstring of the task
        left = named.distance * STROKE - named.set_point * WINDOW  # m
        step = ACCELERATION * STEP
        # the parabola at the end of the step; within one step it is a straight line
        allowed = np.sqrt((step / 2) ** 2 + 2 * ACCELERATION * abs(left)) - step / 2
        wanted = np.sign(left) * min(allowed, abs(left) / STEP, 1.0)
        self.velocity = np.clip(wanted, self.velocity - step, self.velocity + step)
        return np.array([self.velocity / MAX_VELOCITY], np.float32)


class Random:
    """Draws random actions."""

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        return env.action_space.sample()


# %% [markdown]
# Each policy plays five episodes with the same seeds; the seed determines start and goal. The
# reward of a step lies in [0, 1], half for nearness, half for being settled within 50 µm.


# %%
def episode(policy, seed: int) -> tuple[np.ndarray, float, dict]:
    """Play an episode; -> distance to the goal by step (m), mean reward, last info."""
    observation, info = env.reset(seed=seed)
    env.action_space.seed(seed)
    distances, total, over = [info["distance"]], 0.0, False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        distances.append(info["distance"])
        total += reward
        over = terminated or truncated
    return np.array(distances), total / env.spec.max_episode_steps, info


SEEDS = range(5)
runs = {kind.__name__: [episode(kind(), seed) for seed in SEEDS] for kind in (Braking, Random)}
scores = {name: np.mean([mean for _, mean, _ in results]) for name, results in runs.items()}
for name, results in runs.items():
    settled = sum(bool(info["is_success"]) for *_, info in results)
    faults = {info["fault"] for *_, info in results} - {""}
    print(f"{name}: mean reward {scores[name]:.2f}, settled {settled} of {len(results)}", *faults)
assert scores["Braking"] > scores["Random"] + 0.3
assert all(info["is_success"] for *_, info in runs["Braking"])

# %%
figure, panels = plt.subplots(1, 2, figsize=(11, 4.5), sharex=True, layout="constrained")
for panel, (name, results) in zip(panels, runs.items(), strict=True):
    for distances, *_ in results:
        time = np.arange(len(distances)) * STEP
        panel.plot(time, np.maximum(np.abs(distances), 1e-6) * 1e3)
        panel.plot(time[-1], max(abs(distances[-1]), 1e-6) * 1e3, "k.")
    panel.axhline(0.05, color="C2", ls="--", label="settled below 50 µm")
    panel.set(yscale="log", ylim=(1e-3, 1e3), xlabel="time (s)", ylabel="distance to the goal (mm)")
    panel.set_title(f"{name}: mean reward {scores[name]:.2f}")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8)
figure.suptitle("LinearAxis-v0, five seeds; a line ends early when the drive has a fault")
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=110)
print(picture)
