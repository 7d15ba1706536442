"""Rates of a machine: whole ratios of its cycles, refused where they are not."""

from collections.abc import Mapping

import mujoco

from ...drive.drive import Drive


def whole_ratio(slow: float, fast: float, slow_name: str, fast_name: str, remedy: str = "") -> int:
    """How many times `fast` (s) fits into `slow` (s)."""
    ratio = round(slow / fast)
    if ratio < 1 or abs(ratio * fast - slow) > 1e-9 * slow:
        raise ValueError(
            f"{slow_name} = {slow * 1e6:g} µs is not a whole multiple of the {fast_name} = "
            f"{fast * 1e6:g} µs: choose another {remedy or fast_name}"
        )
    return ratio


def rates(model: mujoco.MjModel, drives: Mapping[str, Drive]) -> tuple[float, int]:
    """The machine's cycle (s), which is the longest position cycle, and its physics steps."""
    cycles = {name: drive.model.cycle_time["position"] for name, drive in drives.items()}
    longest = max(cycles, key=lambda name: cycles[name])
    for name, cycle in cycles.items():
        whole_ratio(
            cycles[longest],
            cycle,
            f"position cycle of drive {longest!r}",
            f"position cycle of drive {name!r}",
            "drive model for one of them",
        )
    steps = whole_ratio(cycles[longest], model.opt.timestep, "machine cycle", "physics step")
    return cycles[longest], steps
