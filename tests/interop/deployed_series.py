"""Long series of deployed episodes in lock-step, beside memory. The page docs/results/deployed.md:

    python tests/interop/deployed_series.py docs/results/deployed.md

plays part by part, on networks of its own, and goes on where it was interrupted.
"""

import argparse
import json
import re
import time
from pathlib import Path

import numpy as np
from deployed import BUSES, FAST, HIGH, HOSTILE, LOW, REFERENCES, TASKS
from rich.console import Console
from wire import on_the_wire

from servogym.training.evaluate.metrics import difference, summarise
from servogym.training.report import markdown, number, progress

PART = 25  # episodes of a run from power-on
RUNS = {"linear": 14, "homing": 3, "tracking": 2, "contour": 1}  # on each bus
ALIKE = 5  # episodes from the state in which those in memory begin
HOURS = 2
METRICS = {
    "episode_return": "return", "success": "success", "settling_time": "settling time (s)",
    "peak_error": "peak error (µm)", "rms_torque": "rms torque (rated)",
}
HEAD = f"""# Tasks on a bus

Four tasks are played on two buses against a served machine in another process: CAN by
udp_multicast with the clock `sync_end`, EtherCAT by SOEM over a veth pair with the clock `frame`.
The drives are `generic`, the seeds start at 0, and each run has {PART} episodes from power-on. A
run begins with a homing (in `Homing-v0` every episode does); the master then moves the axes to
their starts.

*Equal steps* have the same observation and reward, byte by byte, as the same run within one process
(what `servogym deploy --lock-step --gap` plays). *In memory* is the environment without any bus,
with the 95 % interval of its mean over resampled episodes (of a success rate, joined with Wilson's
interval). Its axes stand at their starts without a motion and without the
torque that holds them there, and its rewards are those of the true load. The difference is that of
the means, bus less memory, with the 95 % interval over resampled pairs: each resample takes the
same episodes of both. Pairing removes what the episodes have in common, so it shows differences far
within the interval of the mean. A metric that the process data of a task do not carry has no row.

```sh
python tests/interop/deployed_series.py docs/results/deployed.md
```

"""


STARTS = f"""## From the same state

What differs is the start. Here the served machine is put into the very state in which the
environment in memory begins, for {ALIKE} episodes each, and the master plays over the bus.
Differences are bus less memory, the largest of any episode. In `Homing-v0` the master's own homing
does not belong to that state, so it cannot judge the home that is declared; the reward of
`GantryContour-v0` is that of the encoders, whose place of the tool is a position cycle old.

"""
GUARD = """## Hostile policies

{policies} policies for `LinearAxis-v0` leave the envelope, chatter, return what is no action,
raise, hang, exit, kill themselves or take all memory, behind a guard with the positions
{low:g}..{high:g} m and {speed:g} m/s. *Named* have the reason that belongs to them, *enabled* are
drives in OPERATION_ENABLED 0.2 s after the end. *Beyond* is how far outside the positions an axis
has come to rest; four steps at {speed:g} m/s and the distance of the quick stop after them are
{stopping:.1f} mm.

"""


def asked(scenario, bus, **arguments):
    """What a scenario of `deployed` returns."""
    return on_the_wire("deployed", scenario, "forked", timeout=3600 * HOURS, bus=bus, **arguments)


def alike(task, bus, seed):
    """Episodes from the states of memory."""
    return asked("byte_equal", bus, task=task, policy=REFERENCES[task], seeds=[*range(ALIKE)],
                 steps=10**6)


def guarded(task, bus, seed):
    """All hostile policies."""
    return asked("hostile", bus, names=[])


def played(task, bus, seed):
    """A part of a series: metrics on the bus and in memory, and how many steps are equal."""
    from servogym.drive.model.model import load
    from servogym.envs.environment.deployed import in_memory
    from servogym.envs.environment.registry import task as named
    from servogym.training.cli.deploy import made_policy

    row = asked("episodes", bus, task=task, policy=REFERENCES[task], count=PART, seed=seed)
    env = named(TASKS[task])(load("generic", bus), randomise={})
    there, _ = in_memory(env, made_policy(REFERENCES[task], env, seed), PART, seed)
    del row["times"]
    return row | {"plain": there}


def series(rows):
    """The section of the series."""
    steps, equal, episodes = (
        sum(row["steps"] for row in rows), sum(row["equal"] for row in rows),
        sum(len(row["deployed"]) for row in rows),
    )
    stopped = [row["stopped"] for row in rows if row["stopped"]]
    said = [
        f"- {episodes} episodes, {equal} of {steps} steps equal the run within one process.",
        f"- The guard has stopped {len(stopped)} runs{': ' * bool(stopped)}{'; '.join(stopped)}.",
    ]
    table, beyond, inside = [], [], 0
    for task, bus in dict.fromkeys((row["task"], row["bus"]) for row in rows):
        own = [row for row in rows if (row["task"], row["bus"]) == (task, bus)]
        pairs = [pair for row in own for pair in zip(row["deployed"], row["plain"], strict=False)]
        name = TASKS[task].removeprefix("servogym/")
        for metric, shown in METRICS.items():
            bus_s, memory_s = (np.array([[each[k][metric] for each in pairs]]) for k in (0, 1))
            if not (bus_s.any() or memory_s.any()):
                continue  # its PDOs do not carry what this is made of
            apart = difference(bus_s, memory_s, share=True)
            mean = summarise(memory_s, better="", share=True)
            inside += mean.low <= bus_s.mean() <= mean.high
            if not apart.low <= 0.0 <= apart.high:
                beyond.append(f"{name} on {bus}: {shown} {number(apart.value)}")
            first = metric == "episode_return"
            table.append([
                *((name, bus, REFERENCES[task], str(len(pairs)),
                   f"{sum(row['equal'] for row in own)} of {sum(row['steps'] for row in own)}")
                  if first else [""] * 5),
                shown, number(bus_s.mean(), 5), number(mean.mean, 5),
                f"{number(mean.low, 5)} .. {number(mean.high, 5)}", number(apart.value),
                f"{number(apart.low)} .. {number(apart.high)}",
            ])
    said += [
        f"- {inside} of {len(table)} means on the bus lie within the 95 % interval of the mean in "
        "memory.",
        f"- The interval of {len(table) - len(beyond)} of {len(table)} paired differences contains "
        f"zero. The others: {'; '.join(beyond) or 'none'}.",
    ]
    heading = ("task", "bus", "policy", "episodes", "equal steps", "metric", "on the bus",
               "in memory", "95 % interval", "difference", "95 % interval")
    return "\n".join(said) + "\n\n" + markdown(heading, table)


def starts(rows):
    """The section of episodes from the states of memory."""
    table = []
    for row in rows:
        apart = {
            metric: max((one[metric] - other[metric] for one, other in
                         zip(row["deployed"], row["memory"], strict=True)), key=abs)
            for metric in METRICS
        }
        table.append([
            TASKS[row["task"]].removeprefix("servogym/"), row["bus"],
            f"{row['begins']} of {len(row['deployed'])}", f"{row['equal']} of {row['steps']}",
            *(number(value) for value in apart.values()),
        ])
    heading = ("task", "bus", "equal beginnings", "equal observations", *METRICS.values())
    return STARTS + markdown(heading, table)


def guard(rows):
    """The section of hostile policies."""
    table = []
    for row in rows:
        told = row["told"]
        table.append([
            row["bus"], str(len(told)),
            str(sum(bool(re.search(HOSTILE[name][1], said)) for name, (said, *_) in told.items())),
            str(sum(state == "OPERATION_ENABLED" for _, state, *_ in told.values())),
            number(1e3 * max(beyond for *_, beyond, _ in told.values())),
            str(sum(stands for *_, stands in told.values())),
        ])
    said = GUARD.format(policies=len(HOSTILE), low=LOW, high=HIGH, speed=FAST,
                        stopping=1e3 * max(row["stopping"] for row in rows))
    heading = ("bus", "policies", "named", "enabled", "most beyond (mm)", "stand")
    return said + markdown(heading, table)


# what is played for a section, and its runs on each bus
PARTS = {"series": (played, RUNS, series), "start": (alike, dict.fromkeys(RUNS, 1), starts),
         "guard": (guarded, {"linear": 1}, guard)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--kept", type=Path, default=Path("out/deployed.jsonl"),
                        help="what has been played, to go on from")
    parser.add_argument("--only", default="", help="parts with this in 'part task'")
    parser.add_argument("--played", action="store_true", help="write the page of what is played")
    options = parser.parse_args()
    options.kept.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in options.kept.open()] if options.kept.exists() else []
    done = {(row["part"], row["task"], row["bus"], row["seed"]) for row in rows}
    cells = [
        (part, task, bus, PART * run) for run in range(max(RUNS.values()))
        for part, (_, runs, _) in PARTS.items() for task in runs for bus in BUSES
        if run < runs[task] and options.only in f"{part} {task}"
    ]
    left = [cell for cell in cells if cell not in done and not options.played]
    console = Console()
    with progress(console, "deployed", len(left)) as count, options.kept.open("a") as file:
        for part, *cell in left:
            begin = time.perf_counter()
            row = PARTS[part][0](*cell)
            names = dict(zip(("task", "bus", "seed"), cell, strict=True))
            rows.append({"part": part, **names, **row})
            print(json.dumps(rows[-1]), file=file, flush=True)
            console.print(part, *cell, f"{time.perf_counter() - begin:.0f} s",
                          *(row[k] for k in ("equal", "steps", "stopped") if k in row))
            count(1.0)
    order = [*TASKS]
    rows.sort(key=lambda row: (order.index(row["task"]), row["bus"], row["seed"]))
    written = [[row for row in rows if row["part"] == part] for part in PARTS]
    text = "\n".join(
        section(own) for (*_, section), own in zip(PARTS.values(), written, strict=True) if own
    )
    options.page.write_text(HEAD + text, encoding="utf-8")


if __name__ == "__main__":
    main()
