"""Environments whose process data travel in EtherCAT frames."""

import gymnasium as gym
import numpy as np
import pytest

from servogym.drive.model.model import load
from servogym.envs.over_ethercat import OverEtherCat

ENVS = ["LinearAxis-v0", "LinearAxisTracking-v0", "GantrySway-v0"]


def make(name, drive="kollmorgen_akd"):
    return gym.make(f"servogym.envs:servogym/{name}", drive=load(drive, "ethercat"))


def episode(env, seed, steps=60):
    observation, info = env.reset(seed=seed)
    env.action_space.seed(seed)
    told = [observation]
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        told.append(np.append(observation, reward))
        if terminated or truncated:
            break
    return b"".join(part.tobytes() for part in told), info


@pytest.mark.parametrize("name", ENVS)
def test_33_an_episode_in_frames_is_the_same_byte_by_byte(name):
    direct, framed = make(name), OverEtherCat(make(name))
    for seed in (1, 2):
        wanted, _ = episode(direct, seed)
        found, info = episode(framed, seed)
        assert found == wanted
        assert info["frames_lost"] == 0


def test_lost_frames_change_the_episode_and_one_seed_repeats_it():
    env = OverEtherCat(make("LinearAxis-v0"), faults=["drop rate=0.2 count=0"])
    direct, _ = episode(make("LinearAxis-v0"), 3)
    first, info = episode(env, 3)
    second, _ = episode(env, 3)
    assert first == second != direct
    assert info["frames_lost"] > 5


def test_a_slave_that_retreats_stops_the_axis_and_the_next_episode_is_whole():
    env = OverEtherCat(make("LinearAxis-v0"), faults=["retreat at=cycle:40 code=0x1B"])
    _, info = episode(env, 4)
    assert info["state"] == "FAULT_REACTION_ACTIVE"  # 6007h: the connection is lost
    direct, _ = episode(make("LinearAxis-v0"), 5, steps=15)
    assert episode(env, 5, steps=15)[0] == direct


def test_a_model_that_is_not_for_ethercat_is_refused_with_the_way_out():
    with pytest.raises(ValueError, match="ethercat"):
        OverEtherCat(gym.make("servogym.envs:servogym/LinearAxis-v0"))
    with pytest.raises(ValueError, match="choose one of"):
        OverEtherCat(make("LinearAxis-v0"), faults=["nonsense"])
