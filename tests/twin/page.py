"""The table of machines in docs/results/twin.md, from the rows of `campaign.py` alone.

    python tests/twin/page.py ROWS.jsonl docs/results/twin.md

The rest of the page stays.
"""

import sys
from pathlib import Path

import numpy as np
from campaign import SERIES, rows

BEGIN, END = "<!-- machines -->", "<!-- end of machines -->"
NAMES = {"velocity_gain": "gains", "integral_time": "gains", "position_gain": "gains"}


def off(parameter):
    """How far off an estimate is, in percent."""
    return 100 * abs(parameter["found"] / parameter["true"] - 1)


def holds(parameter):
    """Whether the interval has the true value."""
    return parameter["low"] <= parameter["true"] <= parameter["high"]


def line(series, own):
    """A row of the table."""
    fitted = [row for row in own if row["verdict"] != "unusable"]
    ratios = [row["held_out"] / row["floor"] for row in fitted]
    errors = {}
    for row in fitted:
        for name, parameter in row["parameters"].items():
            short = NAMES.get(name, name.split("_")[0] if "friction" in name
                              else name.rpartition("_")[2])
            errors.setdefault(short, []).append(off(parameter))
    median = ", ".join(f"{n} {np.median(values):.2g} %" for n, values in errors.items())
    all_of = [each for row in fitted for each in row["parameters"].values()]
    verdicts = [row["verdict"] for row in own]
    told = ", ".join(f"{verdicts.count(each)} {each}" for each in dict.fromkeys(verdicts))
    seeds = sorted(row["seed"] for row in own)
    cover = f"{sum(map(holds, all_of))} of {len(all_of)}" if all_of else "–"
    return (
        f"| {series} | {seeds[0]}–{seeds[-1]} | {len(own)} | {np.median(ratios):.2f}, "
        f"{max(ratios):.2f} | {told} | {median or '–'} | {cover} | "
        f"{np.median([row['cpu'] for row in fitted]):.0f} |"
    )


def machines(found):
    """The section."""
    lines = [
        "| machine | seeds | number | over the floor: median, largest | verdicts | median error | "
        "intervals hold | CPU-s |", "|---|---|---:|---|---|---|---:|---:|",
    ]
    lines += [line(series, own) for series in SERIES
              if (own := [row for row in found if row["series"] == series])]
    all_of = [(row, n, each) for row in found for n, each in row.get("parameters", {}).items()]
    true = sum(holds(each) for _, _, each in all_of)
    missed = "; ".join(f"{row['series']} {row['seed']} {name} ({off(each):.2g} % off, half width "
                       f"{50 * (each['high'] - each['low']) / each['true']:.2g} %)"
                       for row, name, each in all_of if not holds(each))
    codes = {code: sum(row["code"] == code for row in found)
             for code in dict.fromkeys(row["code"] for row in found)}
    lines += [
        "", f"Of {len(all_of)} true values, {true} lie in their 95 % intervals "
        f"({100 * true / max(len(all_of), 1):.1f} %). Missed: {missed or 'none'}.", "",
        "Rows by the estimator that made them (a hash of its files): " + ", ".join(
            f"{code}: {count}" for code, count in codes.items()) + ".",
    ]
    return "\n".join(lines)


def main(source, target):
    page = Path(target).read_text(encoding="utf-8")
    head, _, rest = page.partition(BEGIN)
    _, _, tail = rest.partition(END)
    text = f"{head}{BEGIN}\n\n{machines(rows(Path(source)))}\n\n{END}{tail}"
    Path(target).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
