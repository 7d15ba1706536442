"""Environments whose process data travel in EtherCAT frames, with faults of the bus."""

import copy
import dataclasses
import json
import pickle
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

from servogym.drive.ethercat.faulty import KINDS, Fault
from servogym.drive.model.model import load
from servogym.envs.environment.registry import task
from servogym.envs.environment.vector_env import ServoVectorEnv
from servogym.training.cli import main

ENVS = ["LinearAxis-v0", "LinearAxisTracking-v0", "GantrySway-v0"]
NEVER = {"drop": 0.0}  # in frames, and none is lost
# each kind of fault, often enough to be met in some steps
LINES = {kind: f"{kind} at=cycle:5 count=0 rate=0.2 frames=3" for kind in KINDS} | {
    "power_cycle": "power_cycle at=cycle:31 frames=7",
    "disconnect": "disconnect at=cycle:11 count=3 frames=4",
    "retreat": "retreat at=cycle:40 code=0x1B",
    "break_link": "break_link at=cycle:37 port=0",
    "heal_link": "heal_link at=cycle:37 port=0",
}


def make(name="LinearAxis-v0", faults=None, drive="kollmorgen_akd", **arguments):
    drive = load(drive, "ethercat")
    return gym.make(f"servogym.envs:servogym/{name}", drive=drive, faults=faults, **arguments)


def steps(env, actions):
    told = []
    for action in actions:
        observation, reward, terminated, _, info = env.step(action)
        told.append(np.append(observation, reward).tobytes())
        if terminated:
            break
    return told, info


def episode(env, seed, steps_=60):
    observation, _ = env.reset(seed=seed)
    env.action_space.seed(7)
    told, info = steps(env, [env.action_space.sample() for _ in range(steps_)])
    return observation.tobytes() + b"".join(told), info


@pytest.mark.parametrize("name", ENVS)
def test_33_an_episode_in_frames_is_the_same_byte_by_byte(name):
    direct, framed = make(name), make(name, NEVER)
    for seed in (1, 2, None):  # without a seed the generator goes on, and frames draw nothing of it
        wanted, _ = episode(direct, seed)
        found, info = episode(framed, seed)
        assert found == wanted
        assert info["frames_lost"] == 0


def test_a_delay_and_long_steps_are_the_same_in_frames():
    for arguments in ({"randomise": {"delay": (1, 3)}}, {"step_time": 0.25}):
        wanted, _ = episode(make(**arguments), 1, 20)
        assert episode(make(faults=NEVER, **arguments), 1, 20)[0] == wanted


def test_lost_frames_change_the_episode_and_one_seed_repeats_it():
    direct, _ = episode(make(), 3)
    env = make(faults={"drop": 0.2})
    first, info = episode(env, 3)
    second, _ = episode(env, 3)
    assert first == second != direct
    assert info["frames_lost"] > 5
    assert episode(make(faults=["drop rate=0.2 count=0"]), 3)[0] == first
    assert episode(make(faults="drop rate=0.2 count=0"), 3)[0] == first
    assert episode(make(faults=[Fault("drop", rate=0.2, count=0)]), 3)[0] == first


def test_a_model_by_its_name_gets_its_face_for_ethercat():
    assert task("LinearAxis-v0")("generic", faults=NEVER).drive.model.bus == "ethercat"
    assert task("LinearAxis-v0")("generic", faults={"encoder_loss": 0.0}).drive.model.bus == "can"


def test_an_evaluation_meets_faults_of_the_bus(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ["eval", "LinearAxis-v0", "--policy", "hold", "--drive", "generic", "--episodes", "2"]
    command += ["--out", str(tmp_path / "out")]
    assert main([*command, "--argument", "faults=retreat at=cycle:9"]) == 0
    told = json.loads((tmp_path / "out" / "eval.json").read_text(encoding="utf-8"))
    assert told["policies"]["hold"]["summary"]["faults"]["mean"] == 1.0


def test_a_slave_that_retreats_stops_the_axis_and_the_next_episode_is_whole():
    env = make(faults=["retreat at=cycle:40 code=0x1B"])
    _, info = episode(env, 4)
    assert info["state"] == "FAULT_REACTION_ACTIVE"  # 6007h: the connection is lost
    assert episode(env, 5, 15)[0] == episode(make(), 5, 15)[0]


def test_a_fault_is_told_in_its_step_though_its_frame_is_lost():
    env = make(faults=["drop at=cycle:20 count=0"])
    env.reset(seed=4)
    for step in range(30):
        if step == 15:
            env.unwrapped.drive.inject("encoder_loss")
        *_, info = env.step(np.zeros(1))
        assert (info["fault"] != "") == (step >= 15)
    lost = {"faults": ["drop at=cycle:20 count=0"], "drive": load("kollmorgen_akd", "ethercat")}
    vector = ServoVectorEnv(task("LinearAxis-v0"), 2, **lost)
    vector.reset(seed=4)
    for _ in range(14):
        assert "fault" not in vector.step(np.zeros((2, 1)))[-1]
    vector.envs[1].drive.inject("encoder_loss")
    infos = vector.step(np.zeros((2, 1)))[-1]
    assert [fault[:5] for fault in infos["fault"]] == ["", "7305h"]


def test_a_master_that_is_silent_for_100_ms_meets_the_watchdog():
    env = make(faults={"drop at=cycle:20": 1.0}, drive="generic")
    _, info = episode(env, 4, 120)
    assert info["frames_lost"] > 0
    slave = env.unwrapped.line._segment.stations[0]
    assert (slave.al.code, slave.drive.axis.connection_lost) == (0x1B, 1)


@pytest.mark.parametrize("kind", KINDS)
def test_after_every_fault_the_next_episode_is_whole(kind):
    late = dataclasses.replace(Fault.parse(LINES[kind]), at="cycle:29")  # 12 steps have 24
    env = make(faults=[late])
    episode(env, 1)
    assert episode(env, 2, 12)[0] == episode(make(), 2, 12)[0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_copy_in_mid_episode_goes_on_bit_for_bit(kind):
    env = make(faults=[LINES[kind]])
    env.reset(seed=6)
    env.action_space.seed(6)
    steps(env, [env.action_space.sample() for _ in range(17)])
    actions = [env.action_space.sample() for _ in range(20)]
    base = env.unwrapped
    copies = [pickle.loads(pickle.dumps(base)), copy.deepcopy(base)]
    wanted = steps(base, actions)
    for other in copies:
        assert steps(other, actions) == wanted
    following = episode(base, None, 9)
    for other in copies:
        assert episode(other, None, 9) == following


def test_many_are_bit_for_bit_as_one_by_one_and_a_pickle_goes_on():
    faults = {"drop": 0.1, "mailbox_silence": 0.1, "wkc slave=0": 0.1, "encoder_loss": 0.002}
    kind = task("LinearAxis-v0")
    arguments = {"drive": "kollmorgen_akd", "faults": faults}
    vector = gym.make_vec("servogym.envs:servogym/LinearAxis-v0", num_envs=4, **arguments)
    vector.reset(seed=3)
    singles = [kind(**arguments) for _ in range(4)]
    for i, env in enumerate(singles):
        env.reset(seed=3 + i)
    vector.action_space.seed(0)
    ended = np.zeros(4, bool)
    for n in range(40):
        actions = vector.action_space.sample()
        observations, _, terminations, _, infos = vector.step(actions)
        for i, env in enumerate(singles):
            if not ended[i]:
                observation, _, terminated, _, info = env.step(actions[i])
                assert observation.tobytes() == observations[i].tobytes()
                assert info["frames_lost"] == infos["frames_lost"][i]
                ended[i] = terminated
                assert terminated == terminations[i]
        if n == 20:
            other = pickle.loads(pickle.dumps(vector))
            same = vector.action_space.sample()
            assert other.step(same)[0].tobytes() == copy.deepcopy(vector).step(same)[0].tobytes()
    assert infos["frames_lost"].sum() > 10
    vector.close()


def test_what_is_no_fault_or_no_model_for_ethercat_is_refused_with_the_way_out():
    with pytest.raises(ValueError, match="ethercat"):
        task("LinearAxis-v0")("metronix_ars2000", faults=NEVER)
    with pytest.raises(ValueError, match="choose one of"):
        make(faults=["nonsense"])
    with pytest.raises(ValueError, match="unknown cause 'nonsense'"):
        make(faults={"nonsense": 0.1})
    with pytest.raises(ValueError, match=r"rate=2\.0 is out of range"):
        make(faults={"drop": 2})
    with pytest.raises(ValueError, match="there are 1"):
        make(faults=["retreat slave=1"])
    with pytest.raises(ValueError, match="port 1 of slave 0 has no cable, only port 0"):
        make(faults=["break_link"])


def test_who_does_not_use_ethercat_loads_nothing_of_it():
    code = (
        "import sys, gymnasium; e = gymnasium.make('servogym.envs:servogym/LinearAxis-v0');"
        "e.reset(seed=1); e.step(e.action_space.sample());"
        "print(*(m for m in sys.modules if m.startswith('servogym.drive.ethercat')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
