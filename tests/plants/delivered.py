"""Every axis as delivered: what becomes of each drive model on all mechanics with light and heavy
loads. The table of docs/results/commissioning.md:

    python tests/plants/delivered.py docs/results/commissioning.md

plays cell by cell and goes on where it was interrupted: build, enable, home by the switch, a move
of 100 mm, and one at full profile.
"""

import argparse
import hashlib
import json
import math
import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from rich.console import Console

from servogym.drive.master import Master, ServoError
from servogym.envs import FAMILY, ROTARY_FAMILY, bode, gantry, linear_axis, rotary_axis, tune
from servogym.envs.autotune.stand import detune
from servogym.envs.masters.port import MachinePort
from servogym.envs.masters.squaring import square
from servogym.envs.plants.gantry import PAIR
from servogym.envs.plants.loops import gains_of
from servogym.envs.plants.shaft import plant_at_shaft
from servogym.envs.plants.sizing import load_of
from servogym.training.report import markdown, progress

INVERTER = "bonfiglioli_act"
SERVOS = (
    "generic", "festo_cmmp_as", "festo_cmmp_as_m0", "festo_cmms", "festo_cmmd",
    "metronix_ars2000", "kollmorgen_akd",
)
MODELS = (*SERVOS, INVERTER)
LIMITS = 6.0, 35.0  # dB and degree, of every loop
REST = 0.5  # s after a move
FULL = 0.98  # of the profile velocity, that a long move reaches
LIKE = 0.10  # that `tune` changes the settling time, at most
TAKES = re.compile(r"it takes ([0-9.]+) (\S+)")
LEAST = 2e-3  # s of it, or so much: few cycles of the slowest position controller


@dataclass(frozen=True)
class Plant:
    """A kind of mechanics, its loads, and where its axes stand and go (m or rad)."""

    make: object
    given: dict
    load: str  # parameter
    loads: tuple[float, ...]
    unit: str
    begin: dict[str, float]
    middle: dict[str, float]
    way: float  # of the move as delivered
    ends: tuple[float, float]  # of the move at full profile


def _linear(name):
    return Plant(linear_axis, {"mechanics": name}, "payload", (1.0, 5.0, 10.0, 20.0, 50.0, 100.0),
                 "kg", {"x": 0.12}, {"x": 0.25}, 0.1, (0.48, 0.02))


def _gantry(names):
    at = {"x": 0.3, "x1": 0.3, "x2": 0.301, "y": 0.2, "z": -0.1}
    places = {name: at[name] for name in names}
    return Plant(gantry, {"x_drives": len(names) - 2}, "payload", (0.0, 0.5, 2.0, 5.0, 8.0, 10.0),
                 "kg", places, places, 0.1, (0.0, 0.0))


PLANTS = {
    **{name: _linear(name) for name in FAMILY},
    "rotary_table": Plant(
        rotary_axis, {"mechanics": "rotary_table"}, "inertia",
        (0.01, 0.5, 5.0, 15.0, 50.0, 500.0), "kg·m²", {"x": 0.5}, {"x": 0.5}, 1.0, (6.0, 0.2),
    ),
    "conveyor": Plant(
        rotary_axis, {"mechanics": "conveyor"}, "inertia",
        (0.01, 0.035, 0.1, 0.5, 2.0, 5.0), "kg·m²", {"x": 0.5}, {"x": 0.5}, 1.0, (3.8, 0.2),
    ),
    "gantry": _gantry(("x", "y", "z")),
    "gantry-x1x2": _gantry((*PAIR, "y", "z")),
}
USUAL = {
    **{name: p.payload for name, p in FAMILY.items()},
    **{name: p.inertia for name, p in ROTARY_FAMILY.items()},
    "gantry": 2.0, "gantry-x1x2": 2.0,
}
STROKES = {"x": (0.78, 0.02), "y": (0.48, 0.02), "z": (-0.28, -0.02)}  # of a gantry


class Red(Exception):
    """What must not be: a fault, or something wrong that nobody has said."""


@dataclass(frozen=True)
class Cell:
    """A drive model on mechanics with a load."""

    model: str
    plant: str
    load: float

    def __str__(self):
        return f"{self.model}, {self.plant}, {self.load:g} {PLANTS[self.plant].unit}"

    def machine(self):
        """As delivered; raises ValueError where it is refused."""
        plant = PLANTS[self.plant]
        return plant.make(self.model, **plant.given, **{plant.load: self.load})

    @property
    def tuned(self):
        """Whether it is tuned as well: a servo drive with the usual or the heaviest load."""
        loads = PLANTS[self.plant].loads
        return self.model != INVERTER and self.load in (USUAL[self.plant], loads[-1])

    @property
    def torque_allows(self):
        """Whether the rated torque holds and moves the load for ever, by the textbook."""
        if self.model == INVERTER or self.plant not in FAMILY:
            return True  # rated 5.1 Nm; a rotary axis has the motor that it needs
        p = FAMILY[self.plant]
        weight = (self.load + p.carriage_mass) * 9.81 * math.sin(math.radians(p.inclination))
        friction = p.coulomb_friction + p.chain_drag + p.chain_drag_growth * 0.54
        radius = p.feed_constant / (2 * math.pi) / p.efficiency
        return math.hypot(weight * radius, friction * radius + p.cogging_torque) <= 1.27


CELLS = [Cell(m, name, load) for name, p in PLANTS.items() for m in MODELS for load in p.loads]


@dataclass(frozen=True)
class Outcome:
    """What became of a cell."""

    cell: Cell
    kind: str  # moves, refused, fault or silent
    said: str = ""
    takes: float = math.nan  # the load that a refusal names, which was played too
    known: tuple[float, float] = (math.inf, math.inf)  # least margins of the model, dB and degree
    measured: tuple[float, float] = (math.inf, math.inf)  # by bode
    settled: tuple[float, float] = (math.nan, math.nan)  # s, as delivered and after `tune`

    @property
    def changed(self):
        """Share by which `tune` changes the settling time; 0 within `LEAST`."""
        before, after = self.settled
        return 0.0 if abs(after - before) <= LEAST else after / before - 1


def play(cell, measure=False, tuned=False):
    """Build it and let it move, with its margins measured and tuned if asked for."""
    try:
        machine = cell.machine()
    except ValueError as error:
        return _refused(cell, str(error), measure, tuned)
    try:
        return _moved(cell, machine, measure, tuned)
    except ServoError as error:
        return Outcome(cell, "fault", f"{error}")
    except (Red, RuntimeError) as error:
        return Outcome(cell, "silent", f"{error}")


def _refused(cell, said, measure, tuned):
    """A refusal names a load that is taken, and what would take this one."""
    takes = TAKES.search(said)
    if not takes or not re.search(r"gear ratio", said):
        return Outcome(cell, "silent", f"refused without a way out: {said}")
    other = replace(cell, load=float(takes[1]))
    heavier = "and more" in said
    if not (other.load > cell.load if heavier else 0.0 < other.load < cell.load):
        return Outcome(cell, "silent", f"refused, but it takes {other.load:g}: {said}")
    found = play(other, measure, tuned)
    if found.kind != "moves":
        return replace(found, cell=cell, kind="silent", said=f"{said} | but: {found.said}")
    said = " | ".join(filter(None, (said, found.said)))
    return replace(found, cell=cell, kind="refused", said=said, takes=other.load)


def _moved(cell, machine, measure, tuned):
    plant = PLANTS[cell.plant]
    if cell.model == INVERTER:
        machine.reset(positions=plant.begin)
        turns(machine)
        return Outcome(cell, "moves")
    machine.reset(positions=plant.middle)
    known, measured = margins(machine), (math.inf, math.inf)
    if measure:
        measured = measured_margins(machine)
    machine.reset(positions=plant.begin)
    moves(machine, plant)
    settled, said = (math.nan, math.nan), ""
    if tuned:
        machine.reset(positions=plant.middle)
        try:
            settled = settling_of(machine, plant)
        except (ServoError, RuntimeError) as error:
            said = f"tune: {error}"
    return Outcome(cell, "moves", said, known=known, measured=measured, settled=settled)


def _beams(machine):
    """Drives that move one thing."""
    names = [*machine.drives]
    return [PAIR, *((n,) for n in names if n not in PAIR)] if PAIR[0] in names else [
        (n,) for n in names
    ]


def margins(machine):
    """The least of all loops, of the model behind the gains the drives have taken."""
    found = []
    for beam in _beams(machine):
        for signs in [(1.0,)] if len(beam) == 1 else [(1.0, 1.0), (1.0, -1.0)]:
            plant = plant_at_shaft(machine, dict(zip(beam, signs, strict=True)))
            found += plant.margins(gains_of(machine.drives[beam[0]]))
    return _least(found, "the model")


def measured_margins(machine):
    """The least that `bode` measures."""
    found = []
    for beam in _beams(machine):
        response = bode(machine, beam[0])
        for m in (response.velocity_margins, response.position_margins):
            found.append((m.gain, m.phase, m.stable))
    return _least(found, "bode")


def _least(found, by):
    if not all(stable for *_, stable in found):
        raise Red(f"a loop is not stable, by {by}")
    gain, phase = (min(each[k] for each in found) for k in (0, 1))
    if gain < LIMITS[0] or phase < LIMITS[1]:
        raise Red(f"margins of {gain:.1f} dB and {phase:.0f}°, by {by}")
    return gain, phase


def moves(machine, plant):
    """Enable, home by the switch, make the moves; the following error stays in its window."""
    everyone = Master(MachinePort(machine), *machine.drives)
    everyone.enable()
    beams = _beams(machine)
    if PAIR in beams:
        square(machine)
        Master(MachinePort(machine), *(n for b in beams for n in b if n not in PAIR)).home()
    else:
        everyone.home()
    for beam in beams:
        name = beam[0]
        ends = STROKES[name[0]] if len(beams) > 1 else plant.ends
        place = _place(machine, name)
        sign = 1.0 if place + plant.way <= max(ends) else -1.0
        _move(machine, beam, place + sign * plant.way)
        drive, gear = machine.drives[name], abs(machine.joint(name)[0])
        fast, rate = (float(x) / gear for x in (drive.axis.profile_speed, drive.axis.acceleration))
        for goal in ends:
            way = abs(goal - _place(machine, name))
            top = _move(machine, beam, goal)
            if way > 1.1 * fast**2 / rate and top < FULL * fast:
                raise Red(f"{name} has come to {top:.3g} of {fast:.3g} m/s or rad/s")


def _place(machine, name):
    """Of the drive, counted on over turns (m or rad)."""
    return float(machine.drives[name].axis.position) / abs(machine.joint(name)[0])


def _move(machine, beam, goal):
    """One move of drives together; -> the highest speed (m/s or rad/s)."""
    axes = [machine.drives[name].axis for name in beam]
    gear = abs(machine.joint(beam[0])[0])
    farthest, fastest = [0.0], [0.0]

    def look():
        farthest[0] = max(farthest[0], *(abs(float(a.following_error)) for a in axes))
        fastest[0] = max(fastest[0], abs(float(axes[0].velocity)) / gear)

    master = Master(MachinePort(machine, look), *beam)
    master.move_to(dict.fromkeys(beam, goal), timeout=60.0)
    window = float(axes[0].following_error_window)
    if farthest[0] > window:
        raise Red(f"{beam[0]} lags by {farthest[0] / window:.2f} of its window")
    machine.step(round(REST / machine.cycle_time))
    for name, axis in zip(beam, axes, strict=True):
        away = abs(_place(machine, name) - goal)
        if axis.range > 0.0:  # the same place a turn farther
            turn = float(axis.range) / gear
            away = min(away % turn, turn - away % turn)
        if away > float(axis.position_window) / gear:
            raise Red(f"{name} rests {1e6 * away:.0f} µm or µrad from its goal")
        if machine.drives[name].fault:
            raise Red(f"{name}: {machine.drives[name].fault}")
    return fastest[0]


def turns(machine):
    """An inverter: enabled on the bus, it turns to and fro at the speed asked for, but the slip."""
    for drive in machine.drives.values():
        for data_set in (1, 2, 3, 4):
            drive.write(0x219C, data_set, 1)  # the state machine commands, not the contacts
    Master(MachinePort(machine), *machine.drives).enable()
    for beam in _beams(machine):
        drives, name = [machine.drives[each] for each in beam], beam[0]
        drive, gear = drives[0], abs(machine.joint(name)[0])
        speed = min(0.02 * gear, 30.0) * 30 / math.pi  # 1/min
        load = load_of(machine, name, 1.0)
        torque = load.peak(0.0, speed * math.pi / 30)  # of its slip line
        slip = 5 + 1.1 * torque / float(drive.axis.velocity_gain) * 30 / math.pi
        for target in (round(speed), -round(speed), 0):
            for each in drives:
                each.write("vl_target_velocity", target)
            machine.step(round(2.0 / machine.cycle_time))  # its ramp is slow
            last = []
            for _ in range(100):
                machine.step()
                last.append(float(drive.axis.velocity) * 30 / math.pi)
            if abs(np.mean(last) - target) > slip:
                raise Red(f"{name} turns at {np.mean(last):.0f} 1/min, asked for {target}")
            if np.ptp(last) > 0.2 * speed:
                raise Red(f"{name} oscillates: {np.ptp(last):.0f} of {target} 1/min")
            if drive.fault:
                raise Red(f"{name}: {drive.fault}")


def settling_of(machine, plant, factor=1.0):
    """Settling time (s) of the first drive's move as delivered, and after `tune`.

    `tune` begins with `factor` times the gains.
    """
    name = _beams(machine)[0]
    before = _settling(machine, name, plant.way)
    for each in name if factor != 1.0 else ():
        detune(machine.drives[each], factor)
    tune(machine, name[0])
    return before, _settling(machine, name, plant.way)


def _settling(machine, beam, way):
    kept, axis = machine.snapshot(), machine.drives[beam[0]].axis
    Master(MachinePort(machine), *machine.drives).enable()
    machine.step(round(REST / machine.cycle_time))
    gear, begin, rows = abs(machine.joint(beam[0])[0]), _place(machine, beam[0]), []
    time = machine.time

    def look():
        rows.append((machine.time - time, _place(machine, beam[0]) - begin))

    Master(MachinePort(machine, look), *beam).move_to(
        dict.fromkeys(beam, way), relative=True, timeout=60.0
    )
    for _ in range(round(REST / machine.cycle_time)):
        machine.step()
        look()
    window = float(axis.position_window) / gear
    times, places = np.array(rows).T
    machine.restore(kept)
    outside = np.flatnonzero(abs(places - way) > window)
    return float(times[outside[-1]])


HEADING = (
    "mechanics", "drive", "moves with", "refused", "it takes", "margins of the model",
    "measured by bode", "tune changes settling by",
)
HEAD = """# Every axis as delivered

Each drive model is tested on all mechanics with six loads. The axis is built, enabled, homed to
the switch (a gantry with two drives in X is squared by its switches), moved by 100 mm (1 rad), and
then moved over the stroke at its full profile. An axis *moves* if the following error stays in its
window, the profile velocity is reached, the axis comes to rest in the position window, and all
loops keep 6 dB and 35°, by the model and as `servogym bode` measures them. A refusal states in one
sentence which load this motor and this drive can move; that load was tested as well. An inverter
has no position control; it is enabled and turned back and forth. `tune` is run with the usual and
the heaviest load, or with the load that a refusal names instead.

```sh
python tests/plants/delivered.py docs/results/commissioning.md
```

The command stores the cells that it has run and continues from there. It runs a cell again if the
axis is commissioned differently, even in a single bit, so all rows belong to one commissioning.

"""


def page(outcomes):
    """The page, of all outcomes."""
    return HEAD + table(outcomes)


def table(outcomes):
    """Sentences, and a row for each drive on each mechanics."""
    rows = []
    for plant, p in PLANTS.items():
        for model in MODELS:
            own = [o for o in outcomes if (o.cell.plant, o.cell.model) == (plant, model)]
            if not own:
                continue
            loads = {kind: ", ".join(f"{o.cell.load:g}" for o in own if o.kind == kind)
                     for kind in ("moves", "refused")}
            red = "; ".join(f"{o.kind} at {o.cell.load:g}: {o.said}" for o in own
                            if o.kind not in loads)
            takes = ", ".join(dict.fromkeys(f"{o.takes:.3g}" for o in own if o.kind == "refused"))
            rows.append([
                plant, model,
                (f"{loads['moves']} {p.unit}" if loads["moves"] else "–")
                + (f"; {red}" if red else ""),
                loads["refused"] or "–", takes or "–", _pair(own, "known"), _pair(own, "measured"),
                _change(own),
            ])
    return "\n".join(sentences(outcomes)) + "\n\n" + markdown(HEADING, rows)


def sentences(outcomes):
    """What the table says, with its numbers."""
    count = {kind: sum(o.kind == kind for o in outcomes)
             for kind in ("moves", "refused", "fault", "silent")}
    allowed = [o for o in outcomes if o.cell.torque_allows]
    movers = sum(o.kind == "moves" for o in allowed)
    servo = [o for o in outcomes if math.isfinite(o.measured[0])]
    said = [
        f"- Of {len(CELLS)} combinations, {len(outcomes)} have been tested: "
        f"{count['moves']} move, {count['refused']} are refused with the load that the axis can "
        f"move, {count['fault']} end in a fault, and {count['silent']} fail without a message.",
    ]
    if len(outcomes) == len(CELLS):
        said.append(f"- Torque and speed allow {len(allowed)} of these; {movers} of them move "
                    f"({100 * movers / max(len(allowed), 1):.1f} %).")
    if servo:
        gain, phase = (min(servo, key=lambda o: o.measured[k]) for k in (0, 1))
        said.append(
            f"- The smallest margins that `bode` measures on {len(servo)} axes are "
            f"{gain.measured[0]:.1f} dB ({gain.cell}) and {phase.measured[1]:.0f}° ({phase.cell})."
        )
    tuned = [o for o in outcomes if math.isfinite(o.settled[0])]
    if tuned:
        most = max(tuned, key=lambda o: abs(o.changed))
        said.append(
            f"- `tune` changes the settling time of {sum(abs(o.changed) <= LIKE for o in tuned)} "
            f"of {len(tuned)} axes by 10 % at most; the largest change is "
            f"{100 * most.changed:+.1f} % ({most.cell}: {most.settled[0]:.3f} s, "
            f"then {most.settled[1]:.3f} s)."
        )
    said += [
        f"- `tune` ends in a fault on the trial move of {o.cell}"
        + (f" (played with {o.takes:.3g})." if o.kind == "refused" else ".")
        for o in outcomes if "tune: " in o.said
    ]
    return said


def _pair(own, name):
    values = np.array([getattr(o, name) for o in own])
    gain, phase = values.min(axis=0)
    return f"{gain:.1f} dB {phase:.0f}°" if math.isfinite(gain) else "–"


def _change(own):
    changes = [o.changed for o in own if math.isfinite(o.settled[0])]
    return f"{100 * max(changes, key=abs):+.1f} %" if changes else "–"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--kept", type=Path, default=Path("out/delivered.jsonl"),
                        help="what has been played, to go on from")
    parser.add_argument("--only", default="", help="cells whose name has this regular expression")
    options = parser.parse_args()
    options.kept.parent.mkdir(parents=True, exist_ok=True)
    earlier, outcomes = kept(options.kept), []
    cells = [cell for cell in CELLS if re.search(options.only, str(cell))]
    with progress(Console(stderr=True), "axes", len(cells)) as done, options.kept.open("a") as file:
        for cell in cells:
            axis, found = earlier.get(cell, ("", None))
            if axis != (now := commissioned(cell)):
                found = play(cell, measure=True, tuned=cell.tuned)
                file.write(json.dumps(asdict(found) | {"commissioned": now}) + "\n")
                file.flush()
            outcomes.append(found)
            if found.kind not in ("moves", "refused"):
                print(f"{found.kind}: {cell}: {found.said}", flush=True)
            done(1)
    options.page.write_text(page(outcomes), encoding="utf-8")


def commissioned(cell):
    """Hash of an axis, its mechanics and drives; or of a refusal and the axis that it names."""
    return hashlib.sha256(_axis(cell)).hexdigest()[:16]


def _axis(cell):
    try:
        machine = cell.machine()
    except ValueError as error:
        takes = TAKES.search(f"{error}")
        other = _axis(replace(cell, load=float(takes[1]))) if takes else b""
        return f"{error}".encode() + other
    model = np.empty(mujoco.mj_sizeModel(machine.model), np.uint8)
    mujoco.mj_saveModel(machine.model, None, model)
    return machine.snapshot() + model.tobytes()


def kept(file):
    """By cell, the last of each: hash of the axis that was played, and the outcome."""
    rows = map(json.loads, file.read_text().splitlines() if file.exists() else [])
    pairs = ("known", "measured", "settled")
    found = {}
    for row in rows:
        cell, axis = Cell(**row["cell"]), row.pop("commissioned")
        values = {name: tuple(row[name]) for name in pairs}
        found[cell] = axis, Outcome(**{**row, "cell": cell, **values})
    return found


if __name__ == "__main__":
    main()
