# %% [markdown]
# # 10 · Write your own task
#
# A flying shear cuts a belt without stopping it: the carriage has to catch up with a mark on the
# moving belt and travel with it. The task is a class of about thirty lines. Its base class provides
# everything else: the drive, vectors, checks, training and commands.

# %%
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from gymnasium.utils.env_checker import check_env

from servogym.drive.kernel.jit import block
from servogym.drive.kernel.words import Mode
from servogym.envs import (
    METRE,
    ServoEnv,
    action,
    clip,
    episode,
    linear_axis,
    observation,
    register,
)

picture = Path(next((a for a in sys.argv if a.endswith(".png")), "out/10_write_your_own_task.png"))

# %% [markdown]
# Two functions are compiled like the drive: `act` converts the action to a set-point in the process
# data, and `judge` computes observation and reward from the answer of the drive. All numbers have
# names. `EPISODE` is the memory of the task; names that begin with an underscore do not appear in
# `info`.

# %%
BELT, FASTEST, WITHIN = 0.15, 0.5, 1e-3  # m/s, m/s, m


@block
def act(episode, action, rpdos):
    episode.mark += BELT * episode._step
    rpdos[0].target_velocity = round(FASTEST * METRE * action.velocity)


@block
def judge(episode, rpdos, tpdos, observation):
    away = episode.mark - tpdos[0].position_actual_value / METRE
    observation.distance = clip(away / 0.1)
    observation.velocity = clip(tpdos[0].velocity_actual_value / (FASTEST * METRE))
    episode.reward = 1.0 / (1.0 + (away / WITHIN) ** 2)
    episode.is_success = abs(away) < WITHIN


class FlyingShearEnv(ServoEnv):
    """Catch up with a mark on a belt and travel with it."""

    ID, STEPS = "mylab/FlyingShear-v0", 200
    MODES = (Mode.CYCLIC_SYNC_VELOCITY, Mode.HOMING)
    RPDO, ACTION = ("target_velocity",), action("velocity")
    OBSERVATION = observation("distance", "velocity")
    EPISODE = episode(("mark", "f8"), ("_step", "f8"))
    act, judge = staticmethod(act), staticmethod(judge)

    def _make(self, model):
        return linear_axis(model)

    def _begin(self, options):
        self.place({"x": self.np_random.uniform(0.1, 0.15)})  # m
        self.episode.mark = options.get("mark", 0.2)
        self.episode._step = self.step_time


register(FlyingShearEnv)

# %% [markdown]
# Gymnasium's own checker accepts the environment, and the same class runs as a vector. If you save
# it as a module `mylab.py`, `servogym train mylab:FlyingShear-v0` and all other commands accept it.

# %%
env = FlyingShearEnv()
check_env(env, skip_render_check=True)

# %% [markdown]
# This compares two control laws. A gain on the distance alone lags behind the mark by speed over
# gain, as every velocity loop without feed-forward does. If the speed of the belt is fed forward,
# only unknown properties of the drive leave an error.

# %%
GAIN = 15.0  # 1/s


def law(forward):
    def act(observation):
        return clip((GAIN * 0.1 * observation.distance + forward * BELT) / FASTEST)

    return act


LAWS = {"gain on the distance": law(0.0), "with the belt's speed fed forward": law(1.0)}
lags, curves = {}, {}
for name, chosen in LAWS.items():
    observed, info = env.reset(seed=1)
    rows = []
    for _ in range(env.STEPS):
        observed, reward, terminated, _, info = env.step([chosen(env.named(observed))])
        assert not terminated, info["fault"]
        rows.append((info["time"], info["mark"], env.machine.data.qpos[0], reward))
    curves[name] = np.array(rows)
    lags[name] = float(1e3 * (info["mark"] - env.machine.data.qpos[0]))
    print(f"{name}: {lags[name]:.2f} mm behind at the end, return {curves[name][:, 3].sum():.1f}")
print(f"speed / gain = {1e3 * BELT / GAIN:.2f} mm")

# %%
figure, panels = plt.subplots(3, 1, figsize=(9, 7.5), sharex=True, layout="constrained")
for colour, (name, rows) in zip(("C1", "C0"), curves.items(), strict=True):
    time, mark, carriage, reward = rows.T
    panels[0].plot(time, 1e3 * carriage, color=colour, label=name)
    panels[1].plot(time, 1e3 * (mark - carriage), color=colour)
    panels[2].plot(time, reward, color=colour)
panels[0].plot(time, 1e3 * mark, "k--", lw=0.9, label="the mark")
panels[1].axhspan(-1e3 * WITHIN, 1e3 * WITHIN, color="C2", alpha=0.15)
panels[0].set(ylabel="position (mm)", title="your own task: travel with a mark on a belt")
panels[1].set(ylabel="mark minus carriage (mm)")
panels[2].set(ylabel="reward", xlabel="time (s)")
panels[0].legend()
for panel in panels:
    panel.grid(alpha=0.3)
picture.parent.mkdir(parents=True, exist_ok=True)
figure.savefig(picture, dpi=110)
print(picture)
