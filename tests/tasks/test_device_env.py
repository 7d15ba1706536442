"""``make_vec(..., device=...)``: on the CPU device of warp what the vectors of the loop give."""

import copy
import importlib.util
import json

import gymnasium as gym
import numpy as np
import pytest

import servogym.envs
from servogym.training import cli

ID = "servogym/LinearAxis-v0"
assert servogym.envs
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


class TestOnTheCpuDevice:
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
            ("servogym/GantrySway-v0", {"autoreset_mode": "NextStep"}, 4e-3),
        ],
    )
    def test_what_a_step_gives_is_that_of_the_loop(self, name, arguments, most):
        import torch

        ours, theirs = (
            gym.make_vec(name, 3, max_episode_steps=12, **arguments, **where)
            for where in ({"threads": 1}, {"device": "cpu"})
        )
        here, _ = ours.reset(seed=5)
        there, _ = theirs.reset(seed=5)
        np.testing.assert_array_equal(here, there.numpy())
        generator = np.random.default_rng(1)
        cut = 0
        for _ in range(18):
            actions = generator.uniform(-0.3, 0.3, ours.action_space.shape).astype(np.float32)
            here, there = ours.step(actions), theirs.step(torch.as_tensor(actions))
            assert isinstance(there[0], torch.Tensor)
            assert there[0].dtype == torch.float32
            np.testing.assert_allclose(there[0].numpy(), here[0], rtol=0, atol=most)
            np.testing.assert_allclose(there[1].numpy(), here[1], rtol=0, atol=most)
            np.testing.assert_array_equal(there[2].numpy(), here[2])
            np.testing.assert_array_equal(there[3].numpy(), here[3])
            assert set(there[4]) == set(here[4])
            cut += here[3].sum()
            if "final_obs" in here[4]:
                np.testing.assert_allclose(
                    there[4]["final_obs"].numpy(), here[4]["final_obs"], rtol=0, atol=most
                )
        assert cut >= 3

    def test_a_fault_that_is_injected_happens_there_too(self):
        vectors = [
            gym.make_vec(ID, 3, faults={"encoder_loss": 0.1}, **where)
            for where in ({"threads": 1}, {"device": "cpu"})
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
            ({"action": "pdo"}, "action=\"pdo\" is not there with device='cpu' yet"),
            ({"history": 2}, "history is not there"),
            ({"previous_action": True}, "previous_action is not there"),
            ({"threads": 2}, "threads: a device has its own"),
        ],
    )
    def test_what_is_not_there_yet_is_refused(self, arguments, words):
        with pytest.raises(ValueError, match=words):
            gym.make_vec(ID, 2, device="cpu", **arguments)

    def test_the_bench_counts_drive_cycles(self, capsys):
        assert cli.main(["bench", "--gpu", "cpu", "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)["rows"]
        for row in rows:
            cycles = row["cycles_per_s_whole"] / row["steps_per_s"]
            assert cycles == pytest.approx(20), "5 ms of 0.25 ms, one drive"

    def test_it_is_not_copied(self):
        vector = gym.make_vec(ID, 1, device="cpu")
        with pytest.raises(TypeError, match="make it where it is needed"):
            copy.deepcopy(vector)
