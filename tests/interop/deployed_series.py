"""Long series of deployed episodes in lock-step, beside memory. The page docs/results/deployed.md:

    python tests/interop/deployed_series.py docs/results/deployed.md

plays part by part, on networks of its own, and goes on where it was interrupted.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from deployed import BUSES, REFERENCES, TASKS
from rich.console import Console
from wire import on_the_wire

from servogym.training.evaluate.metrics import difference
from servogym.training.report import markdown, number, progress

PART = 25  # episodes of a run from power-on
RUNS = {"linear": 14, "homing": 3, "tracking": 2, "contour": 1}  # on each bus
HOURS = 2
METRICS = {
    "episode_return": "return", "success": "success", "settling_time": "settling time (s)",
    "peak_error": "peak error (µm)", "rms_torque": "rms torque (rated)",
}
HEAD = f"""# Tasks on a bus

Four tasks are played on two buses against a served machine in another process: CAN by
udp_multicast with the clock `sync_end`, EtherCAT by SOEM over a veth pair with the clock `frame`,
`generic` drives, seeds from 0, in runs of {PART} episodes from power-on. A run begins with a
homing, in `Homing-v0` every episode does; the master then moves the axes to their starts.

*Equal steps* have the same observation and reward, byte by byte, as the same run within one process
(what `servogym deploy --lock-step --gap` plays). *In memory* is the environment without any bus:
its axes stand at their starts without a motion and without the torque that holds them there, its
set-points act from the next cycle on, and its rewards are those of the true load. The difference is
that of the means, bus less memory, with the 95 % interval of episodes drawn again in pairs.

```sh
python tests/interop/deployed_series.py docs/results/deployed.md
```

"""


def played(task, bus, seed):
    """A part of a series: metrics on the bus and in memory, and how many steps are equal."""
    from servogym.drive.model.model import load
    from servogym.envs.environment.deployed import in_memory
    from servogym.envs.environment.registry import task as named
    from servogym.training.cli.deploy import _policy

    row = on_the_wire(
        "deployed", "episodes", "forked", timeout=3600 * HOURS, bus=bus, task=task,
        policy=REFERENCES[task], count=PART, seed=seed,
    )
    env = named(TASKS[task])(load("generic", bus), randomise={})
    there, _ = in_memory(env, _policy(REFERENCES[task], env, seed), PART, seed)
    del row["times"]
    return {"task": task, "bus": bus, "seed": seed, **row, "plain": there}


def page(rows):
    """The page, of all parts."""
    steps, equal, episodes = (
        sum(row["steps"] for row in rows), sum(row["equal"] for row in rows),
        sum(len(row["deployed"]) for row in rows),
    )
    stopped = [row["stopped"] for row in rows if row["stopped"]]
    said = [
        f"- {episodes} episodes, {equal} of {steps} steps equal the run within one process.",
        f"- The guard has stopped {len(stopped)} runs{': ' * bool(stopped)}{'; '.join(stopped)}.",
    ]
    table, beyond = [], []
    for task, bus in dict.fromkeys((row["task"], row["bus"]) for row in rows):
        own = [row for row in rows if (row["task"], row["bus"]) == (task, bus)]
        pairs = [pair for row in own for pair in zip(row["deployed"], row["plain"], strict=False)]
        name = TASKS[task].removeprefix("servogym/")
        for metric, shown in METRICS.items():
            bus_s, memory_s = (np.array([[each[k][metric] for each in pairs]]) for k in (0, 1))
            apart = difference(bus_s, memory_s, share=True)
            if not apart.low <= 0.0 <= apart.high:
                beyond.append(f"{name} on {bus}: {shown} {number(apart.value)}")
            first = metric == "episode_return"
            table.append([
                *((name, bus, REFERENCES[task], str(len(pairs)),
                   f"{sum(row['equal'] for row in own)} of {sum(row['steps'] for row in own)}")
                  if first else [""] * 5),
                shown, number(bus_s.mean(), 5), number(memory_s.mean(), 5), number(apart.value),
                f"{number(apart.low)} .. {number(apart.high)}",
            ])
    said.append(
        f"- The interval of {len(table) - len(beyond)} of {len(table)} differences to the "
        f"environment in memory contains zero. The others: {'; '.join(beyond) or 'none'}."
    )
    heading = ("task", "bus", "policy", "episodes", "equal steps", "metric", "on the bus",
               "in memory", "difference", "95 % interval")
    return HEAD + "\n".join(said) + "\n\n" + markdown(heading, table)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--kept", type=Path, default=Path("out/deployed.jsonl"),
                        help="what has been played, to go on from")
    parser.add_argument("--only", default="", help="tasks with this in their name")
    parser.add_argument("--played", action="store_true", help="write the page of what is played")
    options = parser.parse_args()
    options.kept.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in options.kept.open()] if options.kept.exists() else []
    done = {(row["task"], row["bus"], row["seed"]) for row in rows}
    left = [
        (task, bus, PART * run) for run in range(max(RUNS.values())) for task in TASKS
        for bus in BUSES
        if run < RUNS[task] and options.only in task and (task, bus, PART * run) not in done
        and not options.played
    ]
    console = Console()
    with progress(console, "deployed", len(left)) as count, options.kept.open("a") as file:
        for cell in left:
            rows.append(played(*cell))
            print(json.dumps(rows[-1]), file=file, flush=True)
            console.print(*cell, rows[-1]["equal"], "of", rows[-1]["steps"], rows[-1]["stopped"])
            count(1.0)
    order = [*TASKS]
    rows.sort(key=lambda row: (order.index(row["task"]), row["bus"], row["seed"]))
    options.page.write_text(page(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
