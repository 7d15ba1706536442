"""`tune`: tunes the loops of a drive by measuring its plant.

It measures the plant through the drive (`bode`) and its friction (`trial`), fits gains to the
required margins (`fit`), measures again with them, and compares before and after: the loops, a
step, and the following error of a move.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..engine.checks import in_range
from ..engine.machine import Machine
from ..plants.loops import gains_of, in_units, measurable, ranges
from .bode import HIGHEST, Excitation, calm, lowest_of, measured, possible
from .fit import Requirements, fit, why_not
from .needs import scipy
from .response import Response
from .stand import Stand
from .trial import Friction, Trial, friction, trial

TRIES = 3  # fits at most; each has less gain if the margins were measured too small
EASE = 0.8
# share of the former following error that new gains must not exceed to replace gains that keep the
# margins, and share of the stiffness that the last measurement allows that ends the search
WORTH = 0.9
LATER = 1.1  # ratio to the former settling time that new gains must not exceed
FEED_FORWARD = "acceleration_feed_forward"
# deviation from the former inertia that is ignored: it is measured while the motor pushes, and the
# losses of a gear have the opposite sign while the load pushes
NEAR = 0.1


@dataclass(frozen=True)
class Tuned:
    """The result of `tune`; the drive has the gains."""

    drive: str
    model: str
    unit: str  # of the joint
    asked: Requirements
    reached: bool  # whether the loops measured afterwards have the required margins
    reason: str  # why not
    objects: dict[str, int]  # in units of the drive
    table: tuple[tuple[str, str, int, str], ...]  # address, name, value, unit
    friction: Friction
    before: Response
    after: Response
    trial_before: Trial
    trial_after: Trial
    together: tuple[str, ...] = ()  # drives on one beam, which all have these gains
    parameters: bytes = field(repr=False, default=b"")

    def __str__(self) -> str:
        old, new = self.trial_before, self.trial_after
        lines = [
            f"drive {self.name} ({self.model}): {self.before.fitted}",
            f"{self.friction}",
            f"{'':24}{'before':>34}{'after':>34}",
            *(
                f"{name:24}{before!s:>34}{after!s:>34}"
                for name, before, after in (
                    ("velocity loop", self.before.velocity_margins, self.after.velocity_margins),
                    ("position loop", self.before.position_margins, self.after.position_margins),
                    ("following error", self._error(old), self._error(new)),
                    ("settling time", self._settling(old), self._settling(new)),
                )
            ),
            *(f"{a:10}{name:34}= {value} {unit}".rstrip() for a, name, value, unit in self.table),
            "margins reached" if self.reached else "margins not reached",
            *([self.reason] if self.reason else []),
        ]
        notes = {
            "before, measured": self.before.note, "before, moved": old.note,
            "after, measured": self.after.note, "after, moved": new.note,
        }
        return "\n".join([*lines, *(f"{when}: {note}" for when, note in notes.items() if note)])

    @property
    def name(self) -> str:
        """Name of the drive, or of both drives that move one beam."""
        return " and ".join(self.together) or self.drive

    def _error(self, of: Trial) -> str:
        if not math.isfinite(of.following_error):
            return "not moved"
        small, unit = (1e6, "µm") if self.unit == "m" else (1e3, "mrad")
        return f"{of.following_error * small:.3g} {unit}"

    def _settling(self, of: Trial) -> str:
        return f"{of.settling:.3f} s" if math.isfinite(of.settling) else "not moved"

    def save(self, path: str | Path) -> None:
        """Write the parameter set, or a picture with the suffix .png.

        The set has the contents that 1010h would store: `servogym node --parameter-file` and
        ``linear_axis(parameter_file=...)`` read it.
        """
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".png":
            from .drawing import draw_tuned

            draw_tuned(self, path)
        else:
            path.write_bytes(self.parameters)


def tune(
    machine: Machine,
    drive: str | None = None,
    *,
    gain_margin: float = 6.0,
    phase_margin: float = 35.0,
    move: float | None = None,
    amplitude: float = 0.1,
    seed: int = 0,
) -> Tuned:
    """Tune the loops of one drive of a machine, which has the gains afterwards and is restored.

    >>> tuned = tune(linear_axis("generic"))                        # doctest: +SKIP
    >>> print(tuned); tuned.save("axis.json"); tuned.save("tune.png")    # doctest: +SKIP

    Args:
        machine: a machine whose axis has room to travel.
        drive: name of the drive; by default the first one.
        gain_margin: smallest gain margin of both loops (dB), 2..40.
        phase_margin: smallest phase margin of both loops (degree), 10..80.
        move: distance of the move that shows the following error (m or rad), with the profile of
            the drive; by default 0.4 of the free travel.
        amplitude: rms of the excitation as a share of the rated torque.
        seed: seed of the random phases.

    Raises:
        ValueError: an unknown drive, one without loops to tune, too little room, or an argument out
            of range.
        RuntimeError: a drive has stopped with a fault, or oscillates with any gain.
        ImportError: the package scipy is missing.
    """
    scipy("optimize")
    possible(amplitude, seed)
    asked = Requirements(
        in_range("gain_margin", gain_margin, 2.0, 40.0, "dB"),
        in_range("phase_margin", phase_margin, 10.0, 80.0, "degree"),
    )
    stand = Stand(machine, drive)
    if move is not None:
        left, right = stand.room
        in_range("move", move, -left, right, stand.unit)
        window = float(stand.drive.axis.position_window) / abs(stand.gear)
        if abs(move) <= window:
            raise ValueError(
                f"move = {move:g} {stand.unit} does not leave the position window, "
                f"±{window:.3g} {stand.unit}: give a longer one"
            )
    own = stand.drive
    try:
        before, rides = _look(stand, amplitude, seed, ride=True)
        stand.put_back()
        trial_before = trial(stand, move)
        stand.put_back()
        original = in_units(own, gains_of(own)) | {FEED_FORWARD: int(own.axis.od[FEED_FORWARD])}
        had = stand.machine.snapshot()
        after, objects, reached = _search(stand, asked, before, original, amplitude, seed + 1)
        trial_after = trial(stand, move)
        reason = "" if reached else why_not(after, asked)
        if refusal := _no_better(stand.unit, asked, before, trial_before, after, trial_after):
            reached, reason = asked.kept(before), refusal
            objects = original
            stand.machine.restore(had)
            stand.keep()
            after, trial_after = before, trial_before
        if reached and math.isinf(trial_after.following_error):
            reached = False
            reason = reason or f"the move is not made with them ({trial_after.note})"
        return Tuned(
            drive=stand.name, model=own.model.name, unit=stand.unit, asked=asked, reached=reached,
            reason=reason, objects=objects, table=_table(stand, objects), friction=rides,
            before=before, after=after, trial_before=trial_before, trial_after=trial_after,
            together=tuple(stand.movers) if stand.movers[1:] else (),
            parameters=own.parameters.export(),
        )
    finally:
        stand.put_back()


def _search(
    stand: Stand, asked: Requirements, before: Response, original: dict[str, int],
    amplitude: float, seed: int,
) -> tuple[Response, dict[str, int], bool]:
    """Fit gains and measure with them, repeatedly; -> response, objects, whether they suffice."""
    own, after, objects, ease = stand.drive, before, original, 1.0
    best: tuple[Response, dict[str, int], bytes] | None = None
    for _ in range(TRIES):
        gains = fit(after, asked, ease, measurable(ranges(own)))
        if gains is None or (best and best[0].gains.stiffness >= WORTH * gains.stiffness):
            break
        objects = in_units(own, gains) | {FEED_FORWARD: original[FEED_FORWARD]}
        inertia = round(after.inertia * 1e9)
        if abs(inertia - original[FEED_FORWARD]) > NEAR * original[FEED_FORWARD]:
            objects[FEED_FORWARD] = inertia
        stand.commission(objects)
        stand.keep()
        after, _ = _look(stand, amplitude, seed, ride=False, earlier=after)
        stand.put_back()
        if asked.kept(after) and not after.note:
            best = after, objects, stand.machine.snapshot()
        elif after.velocity_margins.stable and after.position_margins.stable:
            # an unstable loop shows that the plant was wrong: it is fitted again, not eased
            ease *= EASE
    if best is None:
        return after, objects, False
    after, objects, found = best
    stand.machine.restore(found)
    stand.keep()
    return after, objects, True


def _no_better(
    unit: str, asked: Requirements, before: Response, had: Trial, after: Response, found: Trial
) -> str:
    """Explain why the former gains of the drive are kept; empty if they are not."""
    keeps, moves = asked.kept(before), math.isfinite(had.following_error)
    if math.isinf(found.following_error) and (keeps or moves):
        return (
            f"the move is not made with them ({found.note}), so the drive keeps its former gains; "
            "the measurement is unreliable, as with much backlash or little excitation"
        )
    if not keeps:
        return ""
    if found.settling > LATER * had.settling:
        return (
            f"the former gains keep the margins, and with the new ones the move settles after "
            f"{found.settling:.3f} s, not {had.settling:.3f} s, so the former gains are kept"
        )
    if found.following_error >= WORTH * had.following_error:
        return (
            "the former gains keep the margins, and the new ones follow no better "
            f"({_micro(found, unit)}, before {_micro(had, unit)}), so the former gains are kept"
        )
    return ""


def _micro(trial: Trial, unit: str) -> str:
    if math.isinf(trial.following_error):
        return "not moved"
    return f"{1e6 * trial.following_error:.0f} µ{unit}"


def _look(
    stand: Stand, amplitude: float, seed: int, ride: bool, earlier: Response | None = None
) -> tuple[Response, Any]:
    """Measure the response with the present gains, and with `ride` the friction."""
    gains = gains_of(stand.drive)
    excitation = Excitation(amplitude, None, lowest_of(gains), HIGHEST / stand.period, seed)
    stand.start()
    response = measured(stand, gains, calm(stand), excitation, earlier, small=ride)
    return response, friction(stand) if ride else None


def _table(stand: Stand, objects: dict[str, int]) -> tuple[tuple[str, str, int, str], ...]:
    rows = []
    for name, value in objects.items():
        row = stand.drive.model.names.get(name)
        if row is None:
            rows.append(("-", f"{name} (maker's tool)", value, "1e-9 kg·m²"))
        else:
            rows.append((f"{row.index:04X}h:{row.subindex:02X}", name, value, row.unit))
    return tuple(rows)
