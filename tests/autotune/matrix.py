"""`tune` from detuned gains on every axis that has one: the table of docs/results/tuning.md.

    python tests/autotune/matrix.py docs/results/tuning.md

plays what is not yet in the page's table, a case after the other, and writes the page after each,
so it goes on where it was interrupted; without the page it begins anew. Beside the margins that
`tune` measures are those of the known plant (`known`).
"""

import argparse
import math
import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import known
from rich.console import Console

from servogym.drive.model.model import load
from servogym.envs import FAMILY, ROTARY_FAMILY, gantry, linear_axis, rotary_axis, tune
from servogym.envs.autotune.stand import Stand, detune
from servogym.envs.autotune.trial import trial
from servogym.training.report import markdown, progress

SERVOS = ("generic", "metronix_ars2000", "festo_cmmp_as", "festo_cmms", "kollmorgen_akd")
RESONANCES = ("20 Hz", "45 Hz", "80 Hz")
FACTORS = (0.3, 3.0)
WORSE = 1.1  # times the following error of the commissioned gains, at most, and 2 µm more:
COUNT = 2e-6  # of the encoder
LATER, CYCLES = 1.1, 2e-3  # times their settling time, and few cycles of a position controller (s)
HEAVY = "100 kg"
HEADING = (
    "axis", "drive or resonance", "gains", "velocity loop", "known", "position loop", "known",
    "commissioned (µm)", "before (µm)", "after (µm)", "settles commissioned (s)", "after (s)",
    "CPU (s)", "reached",
)
HEAD = """# Tuning from detuned gains

`tune` starts from gains that are 0.3 and 3 times those of the commissioned axis and tunes for
margins of 6 dB and 35°. The cases are each member of the family with each servo drive, with 100 kg
or with a payload on a spring that resonates at 20, 45 or 80 Hz (`generic`; there the commissioned
gains are those of the rule, which ignores the resonance), and each drive of a gantry. The
following error is measured on the move that `tune` shows, with the commissioned gains, before and
after (for rotary axes in µrad), and so is the time until the position stays in its window.

```sh
python tests/autotune/matrix.py docs/results/tuning.md   # runs the cases missing in the table
```

"""
FOOT = """
Margins are the smallest of the loops, measured after tuning. *Known* margins are those of the
model itself: python-control computes them from the physics as linearised by MuJoCo with the same
controllers, without excitation or fit. With backlash or a gear with losses (ball_screw, vertical,
rack_pinion, rotary_table) this is the plant on one flank, which determines the response at small
amplitudes; at large amplitudes the plant is softer. `tune` measures both, and uses the smaller
margins if the plants differ by more than 5 %. If the known margins are smaller than requested,
`tune` did not detect that: request 10° more there.
"""


@dataclass(frozen=True)
class Case:
    """One tuning: an axis, with a drive, a resonance or the drives detuned, from detuned gains."""

    axis: str
    variant: str
    factor: float

    def __str__(self) -> str:
        return f"{self.axis}, {self.variant}, ×{self.factor:g}"

    @property
    def linear(self) -> bool:
        """Whether the known plant is linear in motion, so that its margins are the margins."""
        return self.axis not in ("ball_screw", "vertical", "rack_pinion", "rotary_table")

    def machine(self):
        """In the middle of its range."""
        if self.axis.startswith("gantry"):
            return in_the_middle(gantry(x_drives=int(self.axis[-1])))
        if self.variant in RESONANCES:
            return springy(self.axis, float(self.variant.split()[0]))
        if self.variant == HEAVY:
            return made(self.axis, payload=float(HEAVY.split()[0]))
        return made(self.axis, self.variant)


CASES = [
    *(Case(axis, drive, factor) for axis in (*FAMILY, *ROTARY_FAMILY) for drive in SERVOS
      for factor in FACTORS),
    *(Case(axis, HEAVY, factor) for axis in FAMILY if axis != "vertical" for factor in FACTORS),
    *(Case(axis, f, factor) for axis in (*FAMILY, *ROTARY_FAMILY) for f in RESONANCES
      for factor in (0.3, 1.0, 3.0)),
    *(Case(axis, drives, factor) for axis, drives in (
        ("gantry 1", "x"), ("gantry 1", "y"), ("gantry 1", "z"),
        ("gantry 2", "x1"), ("gantry 2", "x2"), ("gantry 2", "x1 x2"),
    ) for factor in FACTORS),
]


def in_the_middle(machine):
    """All axes with ends, half-way between them."""
    ends = [(float(m["low"]), float(m["high"])) for m in machine.mechanics]
    machine.reset(
        positions={
            name: (low + high) / 2
            for name, (low, high) in zip(machine.drives, ends, strict=True)
            if high - low < 1e6
        }
    )
    return machine


def made(name, drive="generic", **values):
    """A member of the family."""
    make = rotary_axis if name in ROTARY_FAMILY else linear_axis
    return in_the_middle(make(drive, mechanics=name, **values))


def springy(name, frequency, drive="generic"):
    """A member of the family whose payload swings on a spring, so that it resonates there.

    Its gains are those of the rule, which has not looked for the resonance.
    """
    if name in ROTARY_FAMILY:
        p = ROTARY_FAMILY[name]
        rotor = load(drive).rotor_inertia * p.gear_ratio**2
        reduced = 1 / (1 / p.inertia + 1 / rotor)
        stiffness = (2 * math.pi * frequency) ** 2 * reduced
        damping = 2 * 0.02 * math.sqrt(stiffness * reduced)
        return made(name, drive, tuned=False, transmission_stiffness=stiffness,
                    transmission_damping=damping)
    p = FAMILY[name]
    rotor = p.rotor_inertia if p.rotor_inertia is not None else load(drive).rotor_inertia
    gear = 2 * math.pi / p.feed_constant
    rest = p.carriage_mass + (rotor + p.transmission_inertia) * gear**2
    reduced = 1 / (1 / p.payload + 1 / rest)
    stiffness = (2 * math.pi * frequency) ** 2 * reduced
    damping = 2 * 0.02 * math.sqrt(stiffness * reduced)
    return made(name, drive, tuned=False, stiffness=stiffness, structural_damping=damping)


@dataclass(frozen=True)
class Played:
    """What became of a case."""

    case: Case
    tuned: object
    commissioned: object  # trial with the commissioned gains
    known: tuple[tuple[float, float, bool], ...]  # margins of the velocity and the position loop
    cpu: float  # s

    @property
    def follows(self) -> bool:
        """Whether it follows as well as with the commissioned gains."""
        most = WORSE * self.commissioned.following_error + COUNT
        return self.tuned.trial_after.following_error <= most

    @property
    def row(self) -> list[str]:
        """Of the table."""
        tuned, micro = self.tuned, lambda x: f"{x * 1e6:.0f}"
        loops = (tuned.after.velocity_margins, tuned.after.position_margins)
        cells = []
        for found, (gain, phase, stable) in zip(loops, self.known, strict=True):
            cells += [
                f"{found.gain:.1f} dB {found.phase:.0f}°" if found.stable else "unstable",
                f"{gain:.1f} dB {phase:.0f}°" if stable else "unstable",
            ]
        said = f"yes; {tuned.reason}" if tuned.reason else "yes"
        return [
            self.case.axis, self.case.variant, f"×{self.case.factor:g}", *cells,
            micro(self.commissioned.following_error), micro(tuned.trial_before.following_error),
            micro(tuned.trial_after.following_error), f"{self.commissioned.settling:.3f}",
            f"{tuned.trial_after.settling:.3f}", f"{self.cpu:.1f}",
            said if tuned.reached else tuned.reason,
        ]


def play(case):
    """Tune from detuned gains."""
    machine = case.machine()
    names = case.variant.split() if case.axis.startswith("gantry") else [next(iter(machine.drives))]
    stand = Stand(machine, names[0])
    commissioned = trial(stand, None)
    stand.put_back()
    for name in names:
        detune(machine.drives[name], case.factor)
    begin = time.process_time()
    tuned = tune(machine, names[0])
    cpu = time.process_time() - begin
    return Played(case, tuned, commissioned, margins_of_model(machine, stand.movers), cpu)


def margins_of_model(machine, movers):
    """Smallest margins of the known loops; of two drives on a beam alike and against another."""
    signs = [(1,), (1, 1), (1, -1)][: len(movers) * 2 - 1]
    both = [
        [known.smallest(loop) for loop in known.loops(machine, dict(zip(movers, s, strict=True)))]
        for s in signs
        if len(s) == len(movers)
    ]
    return tuple(
        (min(g for g, _, _ in found), min(p for _, p, _ in found), all(s for _, _, s in found))
        for found in zip(*both, strict=True)
    )


def _margin(cell):
    """How far gain (dB) and phase (degree) of a cell are above those asked for."""
    found = re.match(r"(\S+) dB (-?\d+)°", cell)
    return (float(found[1]) - 6.0, float(found[2]) - 34.5) if found else (-math.inf, -math.inf)


def _axes(rows):
    return ", ".join(dict.fromkeys(row[0] for row in rows)) or "none"


def _cases(rows):
    return "; ".join(", ".join(row[:3]) for row in rows) or "none"


def page(rows):
    """The page, of rows as text."""
    yes = sum(row[-1].startswith("yes") for row in rows)
    numbers = [[float(x) for x in row[7:-1]] for row in rows]
    worse = [row for row, (told, _, after, *_) in zip(rows, numbers, strict=True)
             if after > WORSE * told + COUNT * 1e6]
    later = [row for row, (*_, told, after, _) in zip(rows, numbers, strict=True)
             if after > LATER * told + CYCLES]
    longest = max((each[-1] for each in numbers), default=0.0)
    short = [row for row in rows if min(*_margin(row[4]), *_margin(row[6])) < 0.0]
    told = (
        f"Of {len(CASES)} cases, {len(rows)} have been run. The margins are reached in {yes}; in"
        "\nthe others the reason is given. The following error is more than "
        f"{WORSE:g} times that of\nthe commissioned gains in {len(worse)}\n({_cases(worse)}),\nthe "
        f"settling time more than {LATER:g} times theirs in {len(later)}\n({_cases(later)}).\n"
        f"The longest took {longest:.1f} s of processor time. The\nmargins of the known plant are "
        f"smaller than requested in {len(short)} ({_axes(short)}).\n\n"
    )
    return HEAD + told + markdown(HEADING, rows) + FOOT


def kept(path):
    """Rows that a page has."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    rows = [[cell.strip() for cell in line[1:-1].split(" | ")] for line in lines
            if re.match(r"\| \w.*×", line)]
    return {tuple(row[:3]): row for row in rows if len(row) == len(HEADING)}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    path = parser.parse_args().page
    rows = kept(path)
    order = {(c.axis, c.variant, f"×{c.factor:g}"): i for i, c in enumerate(CASES)}
    with progress(Console(stderr=True), "tuning", len(CASES)) as done:
        for key, number in order.items():
            if key not in rows:
                rows[key] = play(CASES[number]).row
            path.write_text(page(sorted(rows.values(), key=lambda r: order[tuple(r[:3])])),
                            encoding="utf-8")
            done(1)


if __name__ == "__main__":
    main()
