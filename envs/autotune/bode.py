"""`bode`: measures the loops of a drive by an excitation through the drive.

A multisine d with random phases is added to the torque command. Each of several runs has new
phases, so that nonlinear effects reduce the coherence. Each run is repeated over the same distance
with -d: half the difference is free of effects that repeat with the position, such as cogging and
gravity. The torque command u and the measured velocity v give, with d as the instrument and sums
over all runs,

    plant = sum(v d*) / sum((u + (h - 1) d) d*)

which is unbiased in a closed loop (Pintelon, Schoukens: System Identification, 2.6). The deviations
of the runs give its variance, and from it the coherence of u and v: behind a stiff loop little of d
is left in u, and the coherence is low. The torque command is sampled once per position cycle, in
which d is held for n velocity cycles; h = (1 + z + ... + z^(n-1)) / n accounts for that.
"""

import math
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

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

PERIOD = 1.0  # s, shortest period of the multisine: one line per Hz
USUAL = 2.0  # Hz, lowest frequency of a usual axis
BELOW = 0.5  # share of the expected position crossover, for a slower axis
SETTLE = 0.4  # s at its beginning, until transients have decayed
LEG = SETTLE + 0.1  # s of travel in one direction, besides the multisine
BLOCKS = 4  # pairs of runs, two in each direction
RESERVE = 4.0  # factor below a gain that only just does not oscillate
LEAST_AMPLITUDE = 0.005  # share of the rated torque
LINES = 110
HIGHEST = 0.3  # share of the position-controller rate; above it images of the hold disturb
SMALL, LIKE = 0.2, 0.05  # share of the amplitude; largest rms logarithm of two equal plants
AGAINST, SMALLER = "drives against one another", "small amplitude"
# above these values the plant is measured behind a softer loop
UNSEEN = 0.03  # share of the lines that are not coherent
HIGHEST_CROSSOVER = 0.08  # crossover as a share of the position-controller rate
SOFT, SOFTER = 0.25, 3  # share of the velocity gain, and the largest number of measurements
DECAYING = 0.9  # ratio of a decaying ripple to the one before
STUCK = (
    "reverses or reaches its torque limit even with the smallest amplitude: the measurement is "
    "unreliable, as behind a loop too soft for the friction"
)
QUIET = 0.15  # share of the rated torque; more ripple without an excitation is an oscillation


class Excitation(NamedTuple):
    """The excitation of a measurement, and the travel during it."""

    amplitude: float  # rms, share of the rated torque
    speed: float | None  # of travel (m/s or rad/s); None: by the profile velocity and the room
    lowest: float  # Hz
    highest: float  # Hz
    seed: int  # of the random phases

    @property
    def period(self) -> float:
        """Period (s) of the multisine."""
        return max(PERIOD, math.ceil(1 / self.lowest))


def bode(
    machine: Machine, drive: str | None = None, *, amplitude: float = 0.1,
    speed: float | None = None, lowest: float | None = None, highest: float | None = None,
    seed: int = 0,
) -> Response:
    """Measure the loops of one drive of a machine, and restore the machine afterwards.

    >>> response = bode(linear_axis("generic"))                     # doctest: +SKIP
    >>> response.velocity_margins, response.position_margins        # doctest: +SKIP

    The axis travels back and forth at a constant speed in mode pv, while the other drives hold
    their positions. If the loop oscillates with its own gains, it is measured with lower ones, and
    `note` reports this; the loops of the response always have the present gains. Two drives that
    move one beam are measured together and against each other; the smaller margins count.

    Args:
        machine: a machine whose axis has room to travel.
        drive: name of the drive; by default the first one.
        amplitude: rms of the excitation as a share of the rated torque, 0.005..1. It is halved
            while the axis reverses or reaches its torque limit.
        speed: travel speed (m/s or rad/s); by default a tenth of the profile velocity.
        lowest: lowest frequency (Hz), 0.2 or more; by default 2, or half the expected crossover of
            a slower position loop.
        highest: highest frequency (Hz); by default 0.3 of the position-controller rate.
        seed: seed of the random phases.

    Raises:
        ValueError: an unknown drive, one without loops to tune, too little room, or an argument out
            of range.
        RuntimeError: a drive has stopped with a fault.
        ImportError: the package scipy is missing.
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
    excitation = Excitation(amplitude, speed, lowest, highest, seed)
    try:
        stand.start()
        if speed is not None:
            unit = f"{stand.unit}/s, what motor and room allow"
            in_range("speed", speed, 1e-6, stand.fastest(excitation.period + LEG), unit)
        return measured(stand, gains, calm(stand), excitation)
    finally:
        stand.put_back()


def lowest_of(gains: Gains) -> float:
    """Return the lowest frequency (Hz) at which loops with these gains are measured."""
    rate = gains.position_gain
    if gains.pid is not None and gains.pid[2] > 0.0:
        rate = gains.pid[0] / gains.pid[2]
    return max(min(USUAL, BELOW * rate / (2 * math.pi)), LOWEST) if rate > 0.0 else USUAL


def possible(amplitude: float, seed: int) -> None:
    """Raise ValueError for an amplitude or a seed out of range."""
    in_range("amplitude", amplitude, LEAST_AMPLITUDE, 1.0, "of the rated torque")
    whole("seed", seed, 0, 2**63)


def measured(
    stand: Stand, gains: Gains, note: str, excitation: Excitation,
    earlier: Response | None = None, small: bool = False,
) -> Response:
    """Return the response of a drive that does not oscillate, with a fitted plant and `gains`.

    Two drives that move one beam are measured together, then against each other. An `earlier`
    measurement is averaged in. If little of the excitation remains behind a stiff loop, the plant
    is measured again behind a softer one. With `small` the plant is also measured at a small
    amplitude, at which a gear with backlash stays on one flank, and added if it differs.
    """

    def found(against: bool, amplitude: float, before: Response | None) -> Response:
        own = excitation._replace(amplitude=amplitude)
        tries: list[tuple[float, Response]] = []
        while len(tries) < SOFTER and not (tries and tries[-1][0] <= 1.0):
            if tries:
                _soften(stand, gains_of(stand.drive), SOFT)
            once = _measure(stand, gains, note, own, against)
            tries.append((_doubt(once, gains_of(stand.drive)), once))
        _, response = min(tries, key=lambda one: one[0])
        response = response.with_earlier(before)
        if stand.drive.axis.od.position_source:
            load = identify(response.of_load, stand.drive)
            response = replace(response, fitted_load=load)
        return replace(response, fitted=identify(response, stand.drive))

    main, also = found(False, excitation.amplitude, earlier), {}
    before = dict(earlier.also) if earlier else {}
    if stand.movers[1:]:
        also[AGAINST] = found(True, excitation.amplitude, before.get(AGAINST))
    less = SMALL * main.amplitude
    if SMALLER in before:
        also[SMALLER] = before[SMALLER]
    if also.get(SMALLER) or (small and less >= LEAST_AMPLITUDE):
        with suppress(RuntimeError):  # too few frequencies are coherent
            other = found(False, less, also.get(SMALLER))
            if also.get(SMALLER) or (other.amplitude == less and main.differs(other) > LIKE):
                also[SMALLER] = other
    return replace(main, also=tuple(also.items()))


def _doubt(response: Response, gains: Gains) -> float:
    """Return a number above 1 if the loop of the measurement, that of `gains`, was too stiff.

    Lines below the crossover of such a loop are hardly visible, and its torque changes between two
    samples.
    """
    unseen = float(np.mean(response.coherence < LEAST_COHERENCE))
    above = abs(response.with_gains(gains).velocity_loop) > 1
    crossover = response.frequencies[above].max(initial=0.0) * response.cycle * response.cycles
    return max(unseen / UNSEEN, crossover / HIGHEST_CROSSOVER)


def calm(stand: Stand) -> str:
    """Lower the gains while the velocity loop oscillates; -> a note on that."""
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
    # a load on a spring comes to rest, which an oscillation of the loop does not
    return second > QUIET * float(stand.drive.axis.rated_torque) and second > DECAYING * first


def _measure(
    stand: Stand, gains: Gains, note: str, excitation: Excitation, against: bool
) -> Response:
    count = round(excitation.period / stand.period)
    wanted = np.geomspace(excitation.lowest, excitation.highest, LINES)
    lines = np.unique(np.rint(wanted * count * stand.period)).astype(int)
    frequencies = lines / (count * stand.period)
    excitation, blocks, stuck = _runs(stand, excitation, lines, count, against)
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
    # relative variance of one run; few runs estimate it badly, so neighbours are averaged
    noise = mean_of_neighbours(noise / abs(velocity.mean(axis=0)) ** 2)
    # np.gradient is a central difference
    position_plant = moved.sum(axis=0) / (0.5 * (z**cycles - z**-cycles)) / torque.sum(axis=0)
    return Response(
        drive=stand.name, model=stand.drive.model.name, frequencies=frequencies, plant=plant,
        position_plant=position_plant, coherence=1 / (1 + noise), gains=gains, cycle=cycle,
        cycles=cycles,
        # the plant includes the filter of an observer
        velocity_filter=float(stand.drive.axis.velocity_filter) or 1.0,
        amplitude=excitation.amplitude, speed=excitation.speed or 0.0, unit=stand.unit,
        filters=filters_of(stand.drive), note=note or (STUCK if stuck else ""),
    )


def _runs(
    stand: Stand, excitation: Excitation, lines: np.ndarray, count: int, against: bool
) -> tuple[Excitation, list[np.ndarray], bool]:
    """Run pairs of excitations; -> the actual one, half the differences, whether an axis stuck."""
    random = np.random.default_rng(excitation.seed)
    settle, leg = round(SETTLE / stand.period), excitation.period + LEG
    speed = stand.speed(leg) if excitation.speed is None else excitation.speed
    amplitude, rated = excitation.amplitude, float(stand.drive.axis.rated_torque)
    blocks: list[np.ndarray] = []
    begin, stuck = stand.machine.snapshot(), False
    while len(blocks) < BLOCKS:
        direction = stand.direction(speed * leg)
        waves = [_multisine(random, lines, count, stand.period) * amplitude * rated for _ in "+-"]
        stand.travel(-direction * speed)
        stand.settle(speed)
        runs: list[np.ndarray] = []
        for wave in (*waves, *(-wave for wave in waves)):
            stand.travel(direction * speed)
            stand.settle(speed)
            samples = stand.run(np.concatenate([wave[-settle:], wave]), against)[settle:]
            if samples[:, [LIMITED, TURNED]].any():
                stand.refuse_hot()
                if amplitude > LEAST_AMPLITUDE:
                    break
                stuck = True
            runs.append(samples)
            direction = -direction
        if len(runs) == 4:
            blocks += [(runs[i] - runs[i + 2]) / 2 for i in range(2)]
        else:
            amplitude = max(amplitude / 2, LEAST_AMPLITUDE)
            blocks.clear()
            stand.machine.restore(begin)
    return excitation._replace(amplitude=amplitude, speed=speed), blocks, stuck


def _multisine(
    random: np.random.Generator, lines: np.ndarray, count: int, period: float
) -> np.ndarray:
    """Return a multisine of random phases, rms 1, with more power at high frequencies."""
    frequencies = lines / (count * period)
    spectrum = np.zeros(count // 2 + 1, complex)
    phases = np.exp(2j * np.pi * random.random(len(lines)))
    spectrum[lines] = phases * np.sqrt(1 + frequencies / 100)
    wave = np.fft.irfft(spectrum, count)
    return wave / np.sqrt(np.mean(wave**2))
