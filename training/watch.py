"""`servogym watch`: shows an environment in a window, in real time, or records it."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
from rich.console import Console

from ..envs.engine.checks import words
from .pictures.video import recording
from .policies import Bound, BuiltIn, Policy, make, needed
from .report import progress
from .setup import Setup

FPS = 25  # desired images per second; each follows a whole number of steps


def run(
    setup: Setup, policy_name: str, episodes: int, seed: int, speed: float, record: Path | None,
    console: Console,
) -> int:
    """Play episodes of a policy, in a window or to a file.

    Args:
        setup: the environment.
        policy_name: as `policies.make` takes it.
        episodes: number of episodes, at least 1.
        seed: seed of the first reset, and of a random policy.
        speed: playback speed; 1 is real time.
        record: file or folder; a window if not given.
        console: receives a line about each episode.

    Raises:
        ValueError: unknown policy, argument or file format, or a policy without actions.
        RuntimeError: no display, or no OpenGL.
        ImportError: no encoder for MP4.
    """
    from ..envs.view.picture import Picture, require_display

    given = needed(policy_name) | dict(setup.arguments)
    try:
        env: Any = gymnasium.make(
            setup.task.ID, drive=setup.drive, disable_env_checker=True, **given
        )
    except TypeError as error:
        raise ValueError(f"--argument: {words(error)}") from None
    policy = make(policy_name, env.unwrapped, seed)
    if isinstance(policy, BuiltIn | Bound):
        raise ValueError(
            f"policy {policy_name!r} gives no actions, there is nothing to watch step by "
            "step: use `servogym eval` or `servogym homing`"
        )
    if record is None:
        require_display()
    stride = max(round(speed / FPS / env.unwrapped.step_time), 1)
    frame_time = stride * env.unwrapped.step_time / speed
    picture = Picture(env.unwrapped)
    writer = recording(record, 1.0 / frame_time) if record is not None else None
    due, frames = time.monotonic(), 0
    shown = console if writer is not None else None

    def frame() -> bool:
        """Draw the present state, in real time in a window; False once that has been closed."""
        nonlocal due, frames
        if writer is not None:
            writer.add(picture.image())
            frames += 1
            return True
        time.sleep(max(due - time.monotonic(), 0.0))
        due = max(due, time.monotonic()) + frame_time
        picture.show()
        return not picture.closed

    try:
        for episode in range(episodes):
            with progress(shown, f"episode {episode + 1}", env.spec.max_episode_steps) as advance:
                ended, what = _episode(
                    env, policy, None if episode else seed, stride, frame, picture.follow, advance
                )
            console.print(f"episode {episode + 1}: {what}", highlight=False)
            if not ended:
                console.print("the window was closed")
                break
    finally:
        if writer is not None:
            writer.close()
        picture.close()
        env.close()
    if writer is not None:
        console.print(
            f"{frames} images, {1.0 / frame_time:g} a second: {record}",
            highlight=False, soft_wrap=True,
        )
    return 0


def _episode(
    env: Any, policy: Policy, seed: int | None, stride: int, frame: Callable[[], bool],
    follow: Callable[[], None], advance: Callable[[float], None],
) -> tuple[bool, str]:
    """Play an episode with a frame every `stride` steps; -> whether it ended, and its outcome."""
    observation, info = env.reset(seed=seed)
    policy.reset(observation, info)
    total, steps, ended = 0.0, 0, False
    watched = frame()
    while watched and not ended:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        follow()
        total, steps, ended = total + float(reward), steps + 1, terminated or truncated
        if ended or steps % stride == 0:
            watched = frame()
        advance(1.0)
    outcome = info["fault"] or ("success" if info["is_success"] else "no success")
    return watched, f"{steps} steps, {info['time']:.3f} s, return {total:.2f}, {outcome}"
