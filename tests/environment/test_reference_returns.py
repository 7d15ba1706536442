"""Environments are frozen by their ids: one episode of each is, bit for bit, that of the page."""

import sys
import zlib
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import servogym.envs  # noqa: F401 (registers the ids)

PAGE = Path(__file__).parents[2] / "docs/reference/returns.md"
STEPS = 60
IDS = sorted(
    name for name in gymnasium.registry if name.startswith("servogym/") and "Robot" not in name
)
HEAD = """# Reference returns

An environment keeps its rollouts as long as it keeps its id: a change that alters them makes a
new version. These are the first 60 steps of each with `reset(seed=0)` and the actions of
`action_space` seeded with 0, added up, with the CRC-32 of all observations (float32, little-
endian). A test holds the table; a new version adds a row.

```sh
python tests/environment/test_reference_returns.py docs/reference/returns.md
```

| environment | return of 60 steps | observations |
|---|---|---|
"""


def row(name):
    """The row of an environment."""
    env = gymnasium.make(name)
    try:
        observation, _ = env.reset(seed=0)
        env.action_space.seed(0)
        total, seen = 0.0, zlib.crc32(np.ascontiguousarray(observation, "<f4").tobytes())
        for _ in range(STEPS):
            observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            total += float(reward)
            seen = zlib.crc32(np.ascontiguousarray(observation, "<f4").tobytes(), seen)
            if terminated or truncated:
                break
        return f"| `{name}` | {total!r} | {seen:08X} |"
    finally:
        env.close()


@pytest.mark.parametrize("name", IDS)
def test_an_environment_plays_what_its_id_promises(name):
    assert row(name) in PAGE.read_text(encoding="utf-8").splitlines()


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(HEAD + "\n".join(map(row, IDS)) + "\n", encoding="utf-8")
