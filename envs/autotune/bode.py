"""`bode`: measure the loops of a drive by an excitation through the drive.

A multisine d of random phases is added to the torque command, anew for each of several runs, so
that what is not linear shows as a lack of coherence. Each run is repeated on the same way with -d:
half the difference of both is free of what repeats with the place, as cogging and gravity do. Of
the torque command u and the measured velocity v follow, with d as the instrument and sums over all,

    plant = sum(v d*) / sum((u + (h - 1) d) d*)

unbiased in a closed loop (Pintelon, Schoukens: System Identification, 2.6). The torque command is
sampled once a position cycle, in which d is held for n velocity cycles: h = (1 + z + ... +
z^(n-1)) / n accounts for it.
"""

from dataclasses import replace

import numpy as np

from ..checks import in_range
from ..engine.machine import Machine
from .identify import identify
from .needs import control
from .response import Response
from .stand import LIMITED, OFFSET, POSITION, TORQUE, VELOCITY, Gains, Stand, gains_of, in_units

PERIOD = 1.0  # s, of the multisine: a line each Hz
SETTLE = 0.4  # s, of its beginning, until what is transient has gone
BLOCKS = 4  # pairs of runs, two in each direction
RESERVE = 4.0  # of the gain to one that only just does not oscillate
LEAST_AMPLITUDE = 0.005  # share of the rated torque
LINES = 110
HIGHEST = 0.3  # share of the position-controller rate; above it the images of the hold blur it
QUIET = 0.15  # of the rated torque: more ripple, before there is an excitation, is an oscillation


def bode(
    machine: Machine,
    drive: str | None = None,
    *,
    amplitude: float = 0.1,
    speed: float | None = None,
    lowest: float = 2.0,
    highest: float | None = None,
    seed: int = 0,
) -> Response:
    """Measure the loops of one drive of a machine, which is afterwards as it was before.

    >>> response = bode(linear_axis("generic"))                     # doctest: +SKIP
    >>> response.velocity_margins, response.position_margins        # doctest: +SKIP

    The axis travels to and fro at a constant speed in mode pv, the other drives hold their
    position. Where the loop oscillates with its own gains, it is measured with smaller ones and
    `note` says so; the loops are always those of the gains in force.

    Args:
        machine: stands where the axis can travel.
        drive: name of it in the machine; the first if not given.
        amplitude: rms of the excitation, share of the rated torque 0.005..1. Halved as long as the
            axis turns round or reaches its torque limit.
        speed: of travel (m/s or rad/s); a tenth of the profile velocity if not given.
        lowest: frequency (Hz).
        highest: frequency (Hz); 0.3 of the position-controller rate if not given.
        seed: of the random phases.

    Raises:
        ValueError: no such drive, one that has nothing to tune, no room, an argument out of range.
        RuntimeError: a drive has left the run with a fault.
        ImportError: without the package control.
    """
    control()
    stand = Stand(machine, drive)
    in_range("amplitude", amplitude, LEAST_AMPLITUDE, 1.0, "of the rated torque")
    nyquist = 0.5 / stand.period
    highest = HIGHEST / stand.period if highest is None else highest
    in_range("highest", highest, 10.0, nyquist, "Hz")
    in_range("lowest", lowest, 1 / PERIOD, highest / 2, "Hz")
    if speed is not None:
        in_range("speed", speed, 1e-6, 1e3, f"{stand.unit}/s")
    gains = gains_of(stand.drive)
    try:
        stand.start()
        note = calm(stand)
        return measured(stand, gains, note, amplitude, speed, lowest, highest, seed)
    finally:
        stand.put_back()


def measured(
    stand: Stand, gains: Gains, note: str, amplitude: float, speed: float | None,
    lowest: float, highest: float, seed: int,
) -> Response:  # fmt: skip
    """The response of a drive that is calm, with a plant fitted to it; the loops are of `gains`."""
    response = _measure(stand, gains, note, amplitude, speed, lowest, highest, seed)
    return replace(response, fitted=identify(response, stand.drive, gains_of(stand.drive)))


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
    stand.drive.commission(in_units(stand.drive, softer))


def _oscillates(stand: Stand) -> bool:
    speed = stand.speed(1.0)
    stand.travel(stand.direction(0.5 * speed) * speed)
    try:
        stand.settle(speed)
        samples = stand.run(np.zeros(round(0.15 / stand.period)))
    except RuntimeError:
        return True
    ripple = float(np.std(samples[:, TORQUE])) / float(stand.drive.axis.rated_torque)
    return bool(samples[:, LIMITED].any()) or ripple > QUIET


def _measure(
    stand: Stand, gains: Gains, note: str, amplitude: float, speed: float | None,
    lowest: float, highest: float, seed: int,
) -> Response:  # fmt: skip
    random = np.random.default_rng(seed)
    count = round(PERIOD / stand.period)
    lines = np.unique(np.rint(np.geomspace(lowest, highest, LINES) * count * stand.period))
    lines = lines.astype(int)
    frequencies = lines / (count * stand.period)
    settle = round(SETTLE / stand.period)
    leg = PERIOD + SETTLE + 0.1
    speed = stand.speed(leg) if speed is None else speed
    rated = float(stand.drive.axis.rated_torque)
    blocks: list[np.ndarray] = []
    begin = stand.machine.snapshot()
    while len(blocks) < BLOCKS:
        direction = stand.direction(speed * leg)
        waves = [_multisine(random, lines, count, frequencies) * amplitude * rated for _ in "+-"]
        stand.travel(-direction * speed)
        stand.settle(speed)
        runs = []
        for sign, wave in [*zip("++", waves, strict=True), *zip("--", waves, strict=True)]:
            stand.travel(direction * speed)
            stand.settle(speed)
            wave = wave if sign == "+" else -wave
            samples = stand.run(np.concatenate([wave[-settle:], wave]))[settle:]
            turned = np.min(samples[:, VELOCITY] * direction * np.sign(stand.gear)) <= 0.0
            if (turned or samples[:, LIMITED].any()) and amplitude > LEAST_AMPLITUDE:
                break
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
    ]  # fmt: skip
    d, u, v, x = (np.array(column) for column in zip(*spectra, strict=True))
    cycle, cycles = stand.rates()
    z = np.exp(2j * np.pi * frequencies * cycle)
    held = sum(z**k for k in range(cycles)) / cycles

    def by_excitation(signal: np.ndarray) -> np.ndarray:
        return (signal * d.conj()).sum(axis=0)

    torque = by_excitation(u + (held - 1) * d)
    power = (abs(v) ** 2).sum(axis=0) * (abs(d) ** 2).sum(axis=0)
    return Response(
        drive=stand.name, model=stand.drive.model.name, frequencies=frequencies,
        plant=by_excitation(v) / torque,
        position_plant=by_excitation(x) / (0.5 * (z**cycles - z**-cycles)) / torque,
        coherence=abs(by_excitation(v)) ** 2 / np.maximum(power, 1e-300),
        gains=gains, cycle=cycle, cycles=cycles,
        velocity_filter=float(stand.drive.axis.velocity_filter), amplitude=amplitude, speed=speed,
        unit=stand.unit, note=note,
    )  # fmt: skip


def _multisine(
    random: np.random.Generator, lines: np.ndarray, count: int, frequencies: np.ndarray
) -> np.ndarray:
    """Of random phases, rms 1; stronger at high frequencies, where inertia leaves little motion."""
    spectrum = np.zeros(count // 2 + 1, complex)
    phases = np.exp(2j * np.pi * random.random(len(lines)))
    spectrum[lines] = phases * np.sqrt(1 + frequencies / 100)
    wave = np.fft.irfft(spectrum, count)
    return wave / np.sqrt(np.mean(wave**2))
