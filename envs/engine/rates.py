"""Rates of a machine: its cycles have whole ratios, all others are refused."""

from collections.abc import Mapping

import mujoco

from ...drive.drive import Drive
from .checks import in_range


def whole_ratio(slow: float, fast: float, slow_name: str, fast_name: str, remedy: str = "") -> int:
    """Return how many times `fast` (s) fits into `slow` (s). Raises ValueError for a fraction."""
    ratio = round(slow / fast)
    if ratio < 1 or abs(ratio * fast - slow) > 1e-9 * slow:
        raise ValueError(
            f"{slow_name} = {slow * 1e6:g} µs is not a whole multiple of the {fast_name} = "
            f"{fast * 1e6:g} µs: choose another {remedy or fast_name}"
        )
    return ratio


def physics_step(timestep: float | None, usual: float) -> float:
    """The physics step (s), `usual` if none is given. Raises ValueError if it is out of range."""
    timestep = usual if timestep is None else timestep
    if not (isinstance(timestep, int | float) and 0.0 < timestep <= 0.01):
        raise ValueError(f"timestep = {timestep!r} is out of range 0..0.01 s")
    return timestep


def rates(model: mujoco.MjModel, drives: Mapping[str, Drive]) -> tuple[float, int]:
    """Cycle of the machine (s), its longest position cycle, and the physics steps in it."""
    cycles = {name: drive.model.cycle_time["position"] for name, drive in drives.items()}
    longest = max(cycles, key=lambda name: cycles[name])
    for name, cycle in cycles.items():
        whole_ratio(
            cycles[longest], cycle, f"position cycle of drive {longest!r}",
            f"position cycle of drive {name!r}", "drive model for one of them",
        )
    steps = whole_ratio(cycles[longest], model.opt.timestep, "machine cycle", "physics step")
    return cycles[longest], steps


def step_cycles(wanted: float | None, usual: float, cycle: float) -> int:
    """Number of position cycles in a step of the agent.

    Args:
        wanted: step time of the user (s), a whole number of cycles; None stands for `usual`.
        usual: step time of the task (s), rounded to the nearest cycle.
        cycle: position cycle of the drives (s).

    Raises ValueError for a time that is not a whole number of cycles, or out of 1..1000 of them.
    """
    seconds = in_range("step_time", usual if wanted is None else wanted, cycle, 1000 * cycle, "s")
    cycles = round(seconds / cycle)
    if wanted is not None and abs(cycles * cycle - seconds) > 1e-6 * seconds:
        raise ValueError(
            f"step_time = {wanted!r} s is not a whole number of position cycles of "
            f"{cycle * 1e6:g} µs: {cycles * cycle:g} is the nearest"
        )
    return cycles


def interpolation_period(step_time: float) -> tuple[int, int]:
    """60C2h: value and index with value × 10^index = `step_time` (s) exactly.

    Raises ValueError where UNSIGNED8 cannot express it.
    """
    for index in range(0, -7, -1):
        value = step_time / 10.0**index
        if 1 <= round(value) <= 255 and abs(value - round(value)) < 1e-6:
            return round(value), index
    raise ValueError(
        f"step_time = {step_time:g} s cannot be written to 60C2h (1..255 times a power of ten): "
        "choose another"
    )
