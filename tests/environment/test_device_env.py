"""``make_vec(..., device=...)``: on the CPU device of warp what the vectors of the loop give.

With ``SERVOGYM_TEST_DEVICE=cuda`` all of it is tried on a GPU instead; ``SERVOGYM_TEST_STEPS=400``
plays whole episodes, which takes the CPU device minutes.
"""

import copy
import importlib.util
import json
import os
import re

import gymnasium as gym
import numpy as np
import pytest

from servogym.envs import TASKS
from servogym.envs.environment.device_env import DeviceVectorEnv
from servogym.training import cli
from servogym.training.bench import device as device_bench

ID = "servogym/LinearAxis-v0"
STEPS = int(os.environ.get("SERVOGYM_TEST_STEPS", "40"))
SEEN, REWARD = 4e-3, 0.1  # some units of an object; what is rewarded may be a matter of 1 µm
DEVICE = os.environ.get("SERVOGYM_TEST_DEVICE", "cpu")
DRAWN = {"friction": (0.5, 1.5), "gains": (0.8, 1.2), "delay": (0, 2), "encoder_noise": 1e-7}
with_warp = [
    pytest.mark.slow,  # warp compiles its kernels for a CPU, the first time for minutes
    pytest.mark.skipif(
        any(importlib.util.find_spec(name) is None for name in ("mujoco_warp", "torch")),
        reason="no mujoco-warp or no torch: pip install 'servogym[gpu]' torch",
    ),
]


def test_a_device_that_is_not_there_is_refused_with_the_next_step():
    words = r"pip install 'servogym\[gpu\]'|^device = .* leave device out"
    with pytest.raises((ImportError, ValueError), match=words):
        gym.make_vec(ID, 2, device="cuda:99")


class TestOnADevice:
    pytestmark = with_warp

    @pytest.mark.parametrize(
        ("name", "arguments", "most"),
        [
            # 2 µm of 1 mm, and some per mille of torque
            (ID, {"autoreset_mode": "NextStep", "prices": {"torque": 0.1, "jerk": 0.1}}, 4e-3),
            (
                "servogym/LinearAxisTracking-v0",
                {
                    "autoreset_mode": "SameStep",
                    "randomise": {"payload": (1, 8), "delay": (0, 3), "encoder_noise": 1e-6},
                },
                4e-3,
            ),
            ("servogym/CompliantAxis-v0", {"autoreset_mode": "Disabled"}, 4e-3),
            ("servogym/GantrySway-v0", {"autoreset_mode": "NextStep", "history": 3}, 4e-3),
            (
                ID,
                {
                    "autoreset_mode": "SameStep",
                    "action": "pdo",
                    "previous_action": True,
                    "history": 2,
                },
                4e-3,
            ),
        ],
    )
    def test_what_a_step_gives_is_that_of_the_loop(self, name, arguments, most):
        import torch

        ours, theirs = (
            gym.make_vec(name, 3, max_episode_steps=12, **arguments, **where)
            for where in ({"threads": 1}, {"device": DEVICE})
        )
        here, _ = ours.reset(seed=5)
        there, _ = theirs.reset(seed=5)
        np.testing.assert_array_equal(here, there.cpu().numpy())
        generator = np.random.default_rng(1)
        cut = 0
        for _ in range(18):
            actions = generator.uniform(-0.3, 0.3, ours.action_space.shape).astype(np.float32)
            here, there = ours.step(actions), theirs.step(torch.as_tensor(actions))
            assert isinstance(there[0], torch.Tensor)
            assert there[0].dtype == torch.float32
            np.testing.assert_allclose(there[0].cpu().numpy(), here[0], rtol=0, atol=most)
            np.testing.assert_allclose(there[1].cpu().numpy(), here[1], rtol=0, atol=most)
            np.testing.assert_array_equal(there[2].cpu().numpy(), here[2])
            np.testing.assert_array_equal(there[3].cpu().numpy(), here[3])
            assert set(there[4]) == set(here[4])
            cut += here[3].sum()
            if "final_obs" in here[4]:
                np.testing.assert_allclose(
                    there[4]["final_obs"].cpu().numpy(), here[4]["final_obs"], rtol=0, atol=most
                )
        assert cut >= 3

    @pytest.mark.parametrize("task", TASKS, ids=lambda task: task.__name__)
    def test_an_episode_of_each_task_is_that_of_the_loop(self, task):
        import torch

        ours, theirs = (
            gym.make_vec(task.ID, 2, **where) for where in ({"threads": 1}, {"device": DEVICE})
        )
        for vector in (ours, theirs):
            vector.reset(seed=3)
        generator = np.random.default_rng(5)
        for step in range(min(task.STEPS, STEPS)):
            if step % 10 == 0:
                actions = generator.uniform(-0.2, 0.2, ours.action_space.shape).astype(np.float32)
            here, there = ours.step(actions), theirs.step(torch.as_tensor(actions))
            seen, reward, ended, cut = (each.cpu().numpy() for each in there[:4])
            np.testing.assert_allclose(seen, here[0], rtol=0, atol=SEEN)
            np.testing.assert_allclose(reward, here[1], rtol=0, atol=REWARD)
            np.testing.assert_array_equal(ended, here[2])
            np.testing.assert_array_equal(cut, here[3])

    @pytest.mark.parametrize("ahead", [False, True], ids=["late", "ahead"])
    @pytest.mark.parametrize("task", TASKS, ids=lambda task: task.__name__)
    def test_who_begins_anew_begins_bit_for_bit_as_in_the_loop(self, task, ahead, monkeypatch):
        monkeypatch.setattr(DeviceVectorEnv, "_busy", lambda vector: ahead)
        vectors = [
            gym.make_vec(task.ID, 4, max_episode_steps=3, autoreset_mode="SameStep",
                         randomise=DRAWN, **where)
            for where in ({"threads": 1}, {"device": DEVICE})
        ]
        ours, theirs = vectors
        acts, mask = np.full(ours.action_space.shape, 0.1, np.float32), np.array([0, 1, 0, 1], bool)
        step = lambda vector: vector.step(acts)  # noqa: E731
        seeded = lambda vector: vector.reset(seed=[9, 1, 9, 2], options={"reset_mask": mask})  # noqa: E731
        partly = lambda vector: vector.reset(  # noqa: E731
            seed=[None, 5, None, None], options={"reset_mask": mask}
        )
        count = 0
        for do in (lambda vector: vector.reset(seed=7), step, seeded, *[step] * 4, partly, step,
                   partly, *[step] * 4):
            (here, *_, infos), (there, *_, its) = map(do, vectors)
            begun = ours._steps == 0
            np.testing.assert_array_equal(begun, theirs._steps == 0)
            np.testing.assert_array_equal(there.cpu().numpy()[begun], here[begun])
            for name in infos.get("parameters", {}):
                np.testing.assert_array_equal(its["parameters"][name], infos["parameters"][name])
            count += begun.sum()
        assert count >= 16
        assert any(ready is not None for ready in theirs._ready) == ahead

    def test_options_are_heeded_though_the_next_episode_had_been_made(self, monkeypatch):
        monkeypatch.setattr(DeviceVectorEnv, "_busy", lambda vector: True)
        vectors = [gym.make_vec(ID, 2, **where) for where in ({"threads": 1}, {"device": DEVICE})]
        for vector in vectors:
            vector.reset(seed=3)
            vector.step(np.zeros((2, 1), np.float32))
        for options in ({"start": 0.2}, {}, {"goal": 0.3}):
            here, there = (vector.reset(options=options)[0] for vector in vectors)
            np.testing.assert_array_equal(there.cpu().numpy(), here)
        with pytest.raises(ValueError, match="start"):
            vectors[1].reset(options={"start": 99.0})
        here, there = (vector.reset(seed=4)[0] for vector in vectors)
        np.testing.assert_array_equal(there.cpu().numpy(), here)

    def test_stable_baselines3_gets_arrays_that_are_those_of_the_loop(self):
        pytest.importorskip("stable_baselines3")
        from servogym.training.learn import sb3

        ours, theirs = (
            sb3.make("LinearAxis-v0", 3, max_episode_steps=4, previous_action=True, **where)
            for where in ({"threads": 1}, {"device": DEVICE})
        )
        for env in (ours, theirs):
            env.seed(2)
        np.testing.assert_array_equal(theirs.reset(), ours.reset())
        ends = 0
        for _ in range(9):
            actions = np.full((3, 1), 0.1, np.float32)
            here, there = ours.step(actions), theirs.step(actions)
            for expected, got in zip(here[:3], there[:3], strict=True):
                assert type(got) is np.ndarray
                assert got.dtype == expected.dtype
                np.testing.assert_allclose(got, expected, rtol=0, atol=4e-3)
            for expected, got, done in zip(here[3], there[3], here[2], strict=True):
                assert set(got) == set(expected)
                if done:
                    ends += 1
                    np.testing.assert_allclose(
                        got["terminal_observation"], expected["terminal_observation"], atol=4e-3
                    )
        assert ends == 6
        with pytest.raises(ValueError, match=r"residual = 'pd' and device = .* on the cores"):
            sb3.make("LinearAxis-v0", 1, device=DEVICE, residual="pd", bounds=[0.1])

    def test_a_policy_is_trained_there_and_goes_on_where_it_was(self, tmp_path, capsys):
        pytest.importorskip("stable_baselines3")
        small = ["--envs", "4", "--argument", "max_episode_steps=5", "--setting", "n_steps=8",
                 "--setting", "batch_size=16", "--setting", "n_epochs=1", "--device", DEVICE,
                 "--evaluate-every", "64"]
        to = ["--out", str(tmp_path / "run")]
        assert cli.main(["train", "LinearAxis-v0", "--steps", "32", *small, *to]) == 0
        assert cli.main(["train", "LinearAxis-v0", "--steps", "64", "--resume", *to]) == 0
        kept = sorted((tmp_path / "run" / "checkpoints").iterdir())[-1]
        assert json.loads((kept / "checkpoint.json").read_text())["device"] == DEVICE
        assert "from step 32 on" in capsys.readouterr().out

    def test_a_fault_that_is_injected_happens_there_too(self):
        vectors = [
            gym.make_vec(ID, 3, faults={"encoder_loss": 0.1}, **where)
            for where in ({"threads": 1}, {"device": DEVICE})
        ]
        seen = []
        for vector in vectors:
            vector.reset(seed=3)
            steps = [vector.step(np.zeros((3, 1), np.float32)) for _ in range(15)]
            seen.append([infos["fault"].tolist() for *_, infos in steps if "fault" in infos])
        assert seen[0] == seen[1] != []

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            ({"faults": {"drop": 0.01}}, "faults of a bus are not available with device="),
            ({"threads": 2}, "threads: a device has its own"),
        ],
    )
    def test_what_is_not_there_yet_is_refused(self, arguments, words):
        with pytest.raises(ValueError, match=words):
            gym.make_vec(ID, 2, device=DEVICE, **arguments)

    def test_the_bench_counts_drive_cycles(self, capsys, monkeypatch):
        monkeypatch.setattr(device_bench, "MANY", {"cpu": (2, 16), "cuda": (2, 64)})
        assert cli.main(["bench", "--gpu", DEVICE, "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        for row in told["rows"]:
            cycles = row["cycles_per_s_whole"] / row["steps_per_s"]
            assert cycles == pytest.approx(20), "5 ms of 0.25 ms, one drive"
            assert row["cycles_per_s"] * row["step_ms"] == pytest.approx(20e3 * row["machines"])
        assert 0 < told["beside"]["position_um"] < 0.2
        assert 0 < told["beside"]["velocity_um_s"] < 200

    def test_the_bench_tells_a_person_how_far_device_and_cores_are_apart(self, capsys, monkeypatch):
        monkeypatch.setattr(device_bench, "MANY", {"cpu": (1,), "cuda": (1,)})
        assert cli.main(["bench", "--gpu", DEVICE]) == 0
        told = " ".join(capsys.readouterr().out.split())
        assert ("no graph" in told) == (DEVICE == "cpu")
        assert re.search(
            r"on the cores, 1 machines: [\d,]+ drive cycles/s; after [0-9]+ steps .* µm", told
        )

    def test_it_is_not_copied(self):
        vector = gym.make_vec(ID, 1, device=DEVICE)
        with pytest.raises(TypeError, match="cannot be copied or pickled: build another one"):
            copy.deepcopy(vector)
