"""The tables of docs/results/twin.md, from the rows of `campaign.py` and `real.py` alone.

    python tests/twin/page.py ROWS.jsonl docs/results/twin.md

Rows of an estimator before that of the checkout are counted as older. What stands outside the
marks stays.
"""

import re
import sys
from pathlib import Path

import numpy as np
from campaign import CODE, SERIES, rows
from health import CHANGES
from real import AXES

NAMES = {"velocity_gain": "gains", "integral_time": "gains", "position_gain": "gains"}
FAIR = 2.0  # times the floor


def off(parameter):
    """How far off an estimate is, in percent."""
    return 100 * abs(parameter["found"] / parameter["true"] - 1)


def holds(parameter):
    """Whether the interval has the true value."""
    return parameter["low"] <= parameter["true"] <= parameter["high"]


def of_kind(found, kind):
    """The rows of a kind of series, in the order of the series."""
    return [row for name, series in SERIES.items() if series.kind == kind
            for row in found if row["series"] == name]


def ratio(row):
    """Held-out error over the floor; of an unusable log there is none."""
    return row["held_out"] / row["floor"] if "floor" in row else np.inf


def older(own):
    """How many rows are of an estimator before the present one, in words."""
    count = sum(row["code"] != CODE for row in own)
    return f", {count} older" if count else ""


def errors(own):
    """Median error of each parameter, in words."""
    kept = {}
    for row in own:
        for name, parameter in row.get("parameters", {}).items():
            short = NAMES.get(name, name.split("_")[0] if "friction" in name
                              else name.rpartition("_")[2])
            kept.setdefault(short, []).append(off(parameter))
    return ", ".join(f"{name} {np.median(values):.2g} %" for name, values in kept.items()) or "–"


def covered(own):
    """How many intervals hold, and which do not."""
    all_of = [(row, n, each) for row in own for n, each in row.get("parameters", {}).items()]
    true = sum(holds(each) for _, _, each in all_of)
    missed = "; ".join(f"{row['series'].removeprefix('bus: ')} {row['seed']} {name} "
                       f"({off(each):.2g} % off, half width "
                       f"{50 * (each['high'] - each['low']) / each['true']:.2g} %)"
                       for row, name, each in all_of if not holds(each))
    return len(all_of), true, missed


def coverage(own):
    """A sentence about all intervals."""
    count, true, missed = covered(own)
    return (f"Of {count} true values, {true} lie in their 95 % intervals "
            f"({100 * true / max(count, 1):.1f} %). Missed: {missed or 'none'}.")


def cost(own):
    """A sentence about processor time."""
    seconds = [row["cpu"] for row in own if "cpu" in row] or [np.nan]
    return (f"A fit took {np.median(seconds):.0f} s of processor time at the median, "
            f"{max(seconds):.0f} s at most.")


def machines(found):
    """Machines with hidden parameters."""
    lines = ["| machine | seeds | played | within 2 × floor | over the floor: median, largest | "
             "verdicts | median error | intervals hold | CPU-s |",
             "|---|---|---:|---:|---|---|---|---:|---:|"]
    all_of = of_kind(found, "machine")
    for series in dict.fromkeys(row["series"] for row in all_of):
        own = [row for row in all_of if row["series"] == series]
        ratios, verdicts = [ratio(row) for row in own], [row["verdict"] for row in own]
        told = ", ".join(f"{verdicts.count(each)} {each}" for each in dict.fromkeys(verdicts))
        seeds = sorted(row["seed"] for row in own)
        count, true, _ = covered(own)
        lines.append(
            f"| {series} | {seeds[0]}–{seeds[-1]} | {len(own)} of {SERIES[series].count}"
            f"{older(own)} | "
            f"{sum(r <= FAIR for r in ratios)} | {np.median(ratios):.2f}, "
            f"{max(ratios):.2f} | {told} | {errors(own)} | "
            f"{f'{true} of {count}' if count else '–'} | "
            f"{np.median([row['cpu'] for row in own if 'cpu' in row]):.0f} |")
    return [*lines, "", coverage(all_of), "", cost(all_of), *said(all_of)]


def said(own):
    """Sentences about logs that were refused as unusable."""
    return [f"\n{row['series']} {row['seed']} was refused: {row['said']}." for row in own
            if row["verdict"] == "unusable"]


def buses(found):
    """Logs of buses, modes and drive models."""
    all_of = {row["series"].removeprefix("bus: "): row for row in of_kind(found, "bus")}
    lines = ["| model | bus | mode | 1 ms | 10 ms |", "|---|---|---|---|---|"]

    def shown(row):
        return "not played" if row is None else (
            "refused" if "floor" not in row else f"{ratio(row):.2f}, {row['verdict']}")

    for name in dict.fromkeys(
            name.removeprefix("bus: ").rpartition(", ")[0] for name, series in SERIES.items()
            if series.kind == "bus"):
        model, bus, mode = name.split(", ")
        cells = [shown(all_of.get(f"{name}, {ms} ms")) for ms in (1, 10)]
        lines.append(f"| `{model}` | {'CAN' if bus == 'can' else 'EtherCAT'} | {mode} | "
                     f"{cells[0]} | {cells[1]} |")
    own = list(all_of.values())
    if mark := older(own):
        lines += ["", f"{len(own)} cells{mark}."]
    return [*lines, "", f"Median errors: {errors(own)}. {coverage(own)} {cost(own)}", *said(own)]


def health(found):
    """New logs of machines whose twin is known."""
    lines = ["| machine | what really changed | logs | told | told without a reason | "
             "true, found [95 %] |", "|---|---|---:|---:|---:|---|"]
    all_of = of_kind(found, "health")
    if not all_of:
        return ["not played"]
    for mechanics, name, change, _ in CHANGES:
        own = [row for row in all_of if row["series"] == f"health: {mechanics}, {name}"]
        if not own:
            continue
        told = [{n for n, each in row["changes"].items() if each["certain"]} for row in own]
        values = []
        for row in own:
            for n, true in row["true"].items():
                each = row["changes"][n]
                per = 100 / each["before"] if each["unit"] == "%" else 1.0
                scale, unit = (1e6, "µm") if each["unit"] == "m" else (1.0, each["unit"])
                values.append(
                    f"{scale * per * true:+.3g}, {scale * each['change']:+.3g} "
                    f"[{scale * each['low']:+.3g}, {scale * each['high']:+.3g}] {unit}")
        lines.append(
            f"| {mechanics} | {name} | {len(own)}{older(own)} | "
            f"{sum(set(change) <= each for each in told) if change else '–'} | "
            f"{sum(len(each - set(change)) for each in told)} | {'; '.join(values) or '–'} |")
    quiet = [each for row in all_of for n, each in row["changes"].items() if n not in row["true"]]
    beyond = sum(not each["low"] <= 0 <= each["high"] for each in quiet)
    return [*lines, "", f"Of {len(quiet)} parameters that had not changed, the 95 % interval of "
            f"{beyond} excludes zero. {cost(all_of)}"]


def real(found):
    """The two real axes."""
    both = {row["series"]: row for row in found if row["series"] in AXES}
    if len(both) < len(AXES):
        return ["not played"]

    def increments(name):
        return [f"{1e6 * row[name]:.1f} µm, {row[name] / row['increment']:.2f} increments"
                for row in both.values()]

    def share(name):
        return [f"{100 * row[name]:.2g} %" if row.get(name) is not None else "–"
                for row in both.values()]

    own = {
        "position, fitted": increments("fitted"), "position, held out": increments("held_out"),
        "following error left over, held out": share("following_error"),
        "torque left over, held out": share("torque"),
        "torque left over while the demand moves": share("torque_in_motion"),
        "verdict": [row["verdict"] for row in both.values()],
        "CPU-s": [f"{row['cpu']:.0f}" for row in both.values()],
    }
    shown = both["axis d"]["log"]
    return [
        "| | axis a: steps | axis d: profile position |", "|---|---:|---:|",
        *(f"| {name} | {' | '.join(cells)} |" for name, cells in own.items()), "",
        f"**Axis d does not repeat its own current within 30 %**: the mean of the other moves in "
        f"the same direction leaves {100 * shown['out']:.0f} % of the current of a move out and "
        f"{100 * shown['back']:.0f} % of one back, while the demand moves. "
        f"{100 * shown['share']:.0f} % of the squared current of the log is of the time at rest, "
        f"where the axis oscillates between increments with {shown['rest']:.2f} A rms, more than "
        f"in motion ({shown['motion']:.2f} A); there {100 * shown['explained']:.0f} % of the "
        f"current follows the position of the same sample. {shown['alike']} moves whose stamps "
        f"have the same phase differ by {shown['travel']:.2f} A while they travel and by "
        f"{shown['stand']:.2f} A at rest.",
    ]


SECTIONS = {"machines": machines, "buses": buses, "health": health, "real axes": real}


def main(source, target):
    found, page = rows(Path(source)), Path(target)
    text = page.read_text(encoding="utf-8")
    for name, section in SECTIONS.items():
        begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        lines = "\n".join([begin, "", *section(found), "", end])
        text, count = re.subn(f"{begin}.*?{end}", lambda _, new=lines: new, text, flags=re.DOTALL)
        assert count == 1, begin
    before = ", ".join(f"`{code}`" for code in sorted({row["code"] for row in found} - {CODE}))
    older_ones = f"Rows counted as older are of {before}." if before else "No row is older."
    text = re.sub("estimator `[^`]*`", f"estimator `{CODE}`", text)
    text = re.sub(r"(?<=seed\. )(Rows counted|No row)[^.]*\.", older_ones, text)
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
