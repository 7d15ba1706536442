"""`bode`: measure the loops of a drive by an excitation through the drive.

A multisine d of random phases is added to the torque command, anew for each of several runs, so
that what is not linear shows as a lack of coherence. Each run is repeated on the same way with -d:
half the difference of both is free of what repeats with the place, as cogging and gravity do. Of
the torque command u and the measured velocity v follow, with d as the instrument and sums over all,

    plant = sum(v d*) / sum((u + (h - 1) d) d*)

unbiased in a closed loop (Pintelon, Schoukens: System Identification, 2.6). How far the runs differ
from it is its variance, and that gives the coherence of u and v: behind a stiff loop little is left
of d in u, and the coherence says so. The torque command is
sampled once a position cycle, in which d is held for n velocity cycles: h = (1 + z + ... +
z^(n-1)) / n accounts for it.
"""

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..engine.checks import in_range, whole
from ..engine.machine import Machine
from ..plants.loops import LOWEST, Gains, filters_of, gains_of, in_units
from .identify import identify
from .margins import LEAST_COHERENCE
from .needs import scipy
from .response import Response, mean_of_neighbours
from .stand import (
    LIMITED,
    OFFSET,
    POSITION,
    TORQUE,
    TURNED,
    VELOCITY,
    Stand,
)

PERIOD = 1.0  # s, of the multisine, at least: a line each Hz
USUAL = 2.0  # Hz, lowest frequency of an axis that is not slow
BELOW = 0.5  # of the position crossover to be expected, where that is slower
SETTLE = 0.4  # s, of its beginning, until what is transient has gone
LEG = SETTLE + 0.1  # s, of travel in one direction beside the multisine
BLOCKS = 4  # pairs of runs, two in each direction
RESERVE = 4.0  # of the gain to one that only just does not oscillate
LEAST_AMPLITUDE = 0.005  # share of the rated torque
LINES = 110
HIGHEST = 0.3  # share of the position-controller rate; above it the images of the hold blur it
SMALL, LIKE = 0.2, 0.05  # of the amplitude; rms of the logarithm of two plants that are alike
AGAINST, SMALLER = "drives against one another", "small amplitude"
UNSEEN = 0.03  # share of the lines, and crossover as a share of the position-controller
HIGHEST_CROSSOVER = 0.08  # rate: above them the plant is measured behind a softer loop
SOFT, SOFTER = 0.25, 3  # of the velocity gain, and how often it is measured at most
DECAYING = 0.9  # of a ripple, from one look to the next
STUCK = (
    "turns round or reaches its torque limit with the least amplitude too: what was measured is no "
    "guide, as behind a loop too soft for the friction"
)
QUIET = 0.15  # of the rated torque: more ripple, before there is an excitation, is an oscillation


def bode(
    machine: Machine, drive: str | None = None, *, amplitude: float = 0.1,
    speed: float | None = None, lowest: float | None = None, highest: float | None = None,
    seed: int = 0,
) -> Response:
    """Measure the loops of one drive of a machine, which is afterwards as it was before.

    >>> response = bode(linear_axis("generic"))                     # doctest: +SKIP
    >>> response.velocity_margins, response.position_margins        # doctest: +SKIP

    The axis travels to and fro at a constant speed in mode pv, the other drives hold their
    position. Where the loop oscillates with its own gains, it is measured with smaller ones and
    `note` says so; the loops are always those of the gains in force. Two drives that move one
    beam are measured together, and one against the other; the margins are the smaller ones.

    Args:
        machine: stands where the axis can travel.
        drive: name of it in the machine; the first if not given.
        amplitude: rms of the excitation, share of the rated torque 0.005..1. Halved as long as the
            axis turns round or reaches its torque limit.
        speed: of travel (m/s or rad/s); a tenth of the profile velocity if not given.
        lowest: frequency (Hz), 0.2 at least; 2 if not given, or half of where a slower position
            loop is expected to cross over.
        highest: frequency (Hz); 0.3 of the position-controller rate if not given.
        seed: of the random phases.

    Raises:
        ValueError: no such drive, one that has nothing to tune, no room, an argument out of range.
        RuntimeError: a drive has left the run with a fault.
        ImportError: without the package scipy.
    """
    scipy("interpolate")
    stand = Stand(machine, drive)
    possible(amplitude, seed)
    nyquist = 0.5 / stand.period
    highest = HIGHEST / stand.period if highest is None else highest
    in_range("highest", highest, 10.0, nyquist, "Hz")
    gains = gains_of(stand.drive)
    lowest = lowest_of(gains) if lowest is None else lowest
    in_range("lowest", lowest, LOWEST, highest / 2, "Hz")
    try:
        stand.start()
        if speed is not None:
            unit = f"{stand.unit}/s, what motor and room allow"
            in_range("speed", speed, 1e-6, stand.fastest(_span(lowest) + LEG), unit)
        note = calm(stand)
        return measured(stand, gains, note, amplitude, speed, lowest, highest, seed)
    finally:
        stand.put_back()


def lowest_of(gains: Gains) -> float:
    """The lowest frequency (Hz) that loops with these gains are measured at."""
    rate = gains.position_gain
    if gains.pid is not None and gains.pid[2] > 0.0:
        rate = gains.pid[0] / gains.pid[2]
    return max(min(USUAL, BELOW * rate / (2 * math.pi)), LOWEST) if rate > 0.0 else USUAL


def _span(lowest: float) -> float:
    """Period (s) of the multisine."""
    return max(PERIOD, math.ceil(1 / lowest))


def possible(amplitude: float, seed: int) -> None:
    """Raises ValueError for an excitation that is none."""
    in_range("amplitude", amplitude, LEAST_AMPLITUDE, 1.0, "of the rated torque")
    whole("seed", seed, 0, 2**63)


def measured(
    stand: Stand, gains: Gains, note: str, amplitude: float, speed: float | None,
    lowest: float, highest: float, seed: int, earlier: Response | None = None, small: bool = False,
) -> Response:
    """The response of a drive that is calm, with a plant fitted to it; the loops are of `gains`.

    Two drives that move one beam are measured together, then one against the other. What was
    measured `earlier` counts as well. Where little is left to see behind a stiff loop, the plant is
    measured once more behind a softer one. With `small` it is measured at a small amplitude, too,
    where a gear with backlash stays on one flank; kept if that is another plant.
    """

    def found(against: bool, amplitude: float, before: Response | None) -> Response:
        tries: list[tuple[float, Response]] = []
        while len(tries) < SOFTER and not (tries and tries[-1][0] <= 1.0):
            if tries:
                _soften(stand, gains_of(stand.drive), SOFT)
            once = _measure(stand, gains, note, amplitude, speed, lowest, highest, seed, against)
            tries.append((_doubt(once, gains_of(stand.drive)), once))
        _, response = min(tries, key=lambda one: one[0])
        response = response.with_earlier(before)
        if stand.drive.axis.od.position_source:
            load = identify(response.of_load, stand.drive)
            response = replace(response, fitted_load=load)
        return replace(response, fitted=identify(response, stand.drive))

    main, also = found(False, amplitude, earlier), {}
    before = dict(earlier.also) if earlier else {}
    if stand.movers[1:]:
        also[AGAINST] = found(True, amplitude, before.get(AGAINST))
    less = SMALL * main.amplitude
    if SMALLER in before:
        also[SMALLER] = before[SMALLER]
    if also.get(SMALLER) or (small and less >= LEAST_AMPLITUDE):
        with suppress(RuntimeError):  # too little of it is coherent
            other = found(False, less, also.get(SMALLER))
            if also.get(SMALLER) or (other.amplitude == less and main.differs(other) > LIKE):
                also[SMALLER] = other
    return replace(main, also=tuple(also.items()))


def _doubt(response: Response, gains: Gains) -> float:
    """Above 1 where the loop it was measured in, that of `gains`, was too stiff for it.

    Little is then left to see of the lines below its crossover, and its torque changes between two
    samples.
    """
    unseen = float(np.mean(response.coherence < LEAST_COHERENCE))
    above = abs(response.with_gains(gains).velocity_loop) > 1
    crossover = response.frequencies[above].max(initial=0.0) * response.cycle * response.cycles
    return max(unseen / UNSEEN, crossover / HIGHEST_CROSSOVER)


def calm(stand: Stand) -> str:
    """Make the gains smaller as long as the velocity loop oscillates; -> what was done."""
    before = gains_of(stand.drive)
    share, moving = 1.0, stand.machine.snapshot()
    while _oscillates(stand):
        share /= 2
        if share < 1 / 500:
            raise RuntimeError(
                f"drive {stand.name!r} oscillates with 1/{round(1 / share)} of its velocity gain "
                "too: the mechanics need damping, or a lower gain to start from"
            )
        stand.machine.restore(moving)
        _soften(stand, before, share)
    if share == 1.0:
        return ""
    share /= RESERVE
    _soften(stand, before, share)
    return f"oscillates with its own gains: measured with 1/{round(1 / share)} of the velocity gain"


def _soften(stand: Stand, before: Gains, share: float) -> None:
    softer = Gains(before.velocity_gain * share, before.integral_time / share, 0.0)
    stand.commission(in_units(stand.drive, softer))


def _oscillates(stand: Stand) -> bool:
    speed = stand.speed(1.0)
    stand.travel(stand.direction(0.5 * speed) * speed)
    try:
        stand.settle(speed)
        runs = [stand.run(np.zeros(round(0.15 / stand.period))) for _ in range(2)]
    except RuntimeError:
        return True
    if any(run[:, LIMITED].any() for run in runs):
        return True
    first, second = (float(np.std(run[:, TORQUE])) for run in runs)
    # a load that swings on its spring comes to rest, which is not an oscillation of the loop
    return second > QUIET * float(stand.drive.axis.rated_torque) and second > DECAYING * first


def _measure(
    stand: Stand, gains: Gains, note: str, amplitude: float, speed: float | None,
    lowest: float, highest: float, seed: int, against: bool,
) -> Response:
    random = np.random.default_rng(seed)
    span = _span(lowest)
    count = round(span / stand.period)
    lines = np.unique(np.rint(np.geomspace(lowest, highest, LINES) * count * stand.period))
    lines = lines.astype(int)
    frequencies = lines / (count * stand.period)
    settle = round(SETTLE / stand.period)
    speed = stand.speed(span + LEG) if speed is None else speed
    rated = float(stand.drive.axis.rated_torque)
    blocks: list[np.ndarray] = []
    begin = stand.machine.snapshot()
    while len(blocks) < BLOCKS:
        direction = stand.direction(speed * (span + LEG))
        waves = [_multisine(random, lines, count, frequencies) * amplitude * rated for _ in "+-"]
        stand.travel(-direction * speed)
        stand.settle(speed)
        runs = []
        for sign, wave in [*zip("++", waves, strict=True), *zip("--", waves, strict=True)]:
            stand.travel(direction * speed)
            stand.settle(speed)
            wave = wave if sign == "+" else -wave
            samples = stand.run(np.concatenate([wave[-settle:], wave]), against)[settle:]
            disturbed = samples[:, [LIMITED, TURNED]].any()
            if disturbed:
                stand.refuse_hot()
            if disturbed and amplitude > LEAST_AMPLITUDE:
                break
            if disturbed:
                note = note or STUCK
            runs.append(samples)
            direction = -direction
        if len(runs) < 4:
            amplitude = max(amplitude / 2, LEAST_AMPLITUDE)
            blocks.clear()
            stand.machine.restore(begin)
            continue
        blocks += [(runs[i] - runs[i + 2]) / 2 for i in range(2)]
    # np.gradient is a central difference
    spectra = [
        [np.fft.rfft(column - column.mean())[lines] for column in (
            run[:, OFFSET], run[:, TORQUE], run[:, VELOCITY], np.gradient(run[:, POSITION]),
        )] for run in blocks
    ]
    d, u, v, x = (np.array(column) for column in zip(*spectra, strict=True))
    cycle, cycles = stand.rates()
    z = np.exp(2j * np.pi * frequencies * cycle)
    held = sum(z**k for k in range(cycles)) / cycles

    torque, velocity, moved = (signal * d.conj() for signal in (u + (held - 1) * d, v, x))
    plant = velocity.sum(axis=0) / torque.sum(axis=0)
    noise = (abs(velocity - plant * torque) ** 2).sum(axis=0) / (len(blocks) - 1)
    # relative variance of one run; few runs tell it badly, so it is that of neighbours as well
    noise = mean_of_neighbours(noise / abs(velocity.mean(axis=0)) ** 2)
    return Response(
        drive=stand.name, model=stand.drive.model.name, frequencies=frequencies,
        plant=plant,
        position_plant=moved.sum(axis=0) / (0.5 * (z**cycles - z**-cycles)) / torque.sum(axis=0),
        coherence=1 / (1 + noise),
        gains=gains, cycle=cycle, cycles=cycles,
        # the filter of an observer is in the plant
        velocity_filter=float(stand.drive.axis.velocity_filter) or 1.0,
        amplitude=amplitude, speed=speed,
        unit=stand.unit, filters=filters_of(stand.drive), note=note,
    )


def _multisine(
    random: np.random.Generator, lines: np.ndarray, count: int, frequencies: np.ndarray
) -> np.ndarray:
    """Return a multisine of random phases, rms 1, with more power at high frequencies."""
    spectrum = np.zeros(count // 2 + 1, complex)
    phases = np.exp(2j * np.pi * random.random(len(lines)))
    spectrum[lines] = phases * np.sqrt(1 + frequencies / 100)
    wave = np.fft.irfft(spectrum, count)
    return wave / np.sqrt(np.mean(wave**2))
