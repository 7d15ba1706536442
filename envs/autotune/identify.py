"""Fits a plant with few parameters to a measured response."""

import math

import numpy as np

from ...drive.drive import Drive
from .margins import LEAST_COHERENCE
from .needs import scipy
from .plant import Plant, Resonance, lag_and_filter, mechanics, sampled
from .response import Response

PROMINENCE = 5.0  # dB above a plant without resonances; smaller peaks do not affect a loop
MOST = 3  # resonances
DAMPING = 0.02  # initial value of the fit
SPREAD = 1.5  # range of a frequency in the fit, as a factor
EXPLAINS = 1.5  # factor by which a further resonance, or a delay, has to reduce the residual
NO_DELAY, LONGEST_DELAY = 1e-6, 4.0  # ms

Pair = tuple[float, float, float, float]  # antiresonance (Hz), its damping, resonance, damping


def identify(response: Response, drive: Drive) -> Plant:
    """Fit a plant to a response.

    Args:
        response: a measured response.
        drive: the drive that was measured.

    Raises:
        RuntimeError: too few frequencies are coherent.
        ImportError: scipy is missing.
    """
    good = response.coherence >= LEAST_COHERENCE
    if good.sum() < 12:
        raise RuntimeError(
            f"only {good.sum()} of {len(good)} frequencies of drive {response.drive!r} are "
            f"coherent: raise the amplitude ({response.amplitude:g} of the rated torque)"
        )
    frequencies = response.frequencies[good]
    lag, share = _shares(drive, response)
    measured = response.plant[good]
    mechanical = measured / lag_and_filter(frequencies, response.cycle, lag, share)
    weight = np.sqrt(np.gradient(np.log(frequencies)))  # the same for each decade
    weight = weight / np.sqrt(np.mean(weight**2))

    def residual(x: np.ndarray) -> np.ndarray:
        values, pairs = _open(x)
        ratio = measured / sampled(
            lambda f: lag_and_filter(f, response.cycle, lag, share)
            * mechanics(f, response.cycle, values, pairs),
            frequencies, response.cycle, response.cycles,
        )
        parts = np.log(np.maximum(abs(ratio), 1e-12)), np.angle(ratio)
        return np.concatenate([part * weight for part in parts])

    solve = scipy("optimize").least_squares

    def fitted(candidates: list[tuple[float, float]], longest: float) -> tuple[float, np.ndarray]:
        """Return score and parameters of a fit with these pairs, and up to this delay (ms)."""
        start = [math.log(inertia), math.log(2 * math.pi * frequencies[0] * inertia * 0.05), 0.0]
        low = [start[0] - 3.0, start[1] - 12.0, -1e-9]
        high = [start[0] + 3.0, start[1] + 6.0, longest]
        start[2] = 0.1 * longest
        for antiresonance, resonance in candidates:
            middle = [math.log(antiresonance), math.log(DAMPING), math.log(resonance)]
            start += [*middle, math.log(DAMPING)]
            spread = math.log(SPREAD)
            low += [middle[0] - spread, -9.0, middle[2] - spread, -9.0]
            high += [middle[0] + spread, 0.5, middle[2] + spread, 0.5]
        found = solve(residual, start, bounds=(low, high), loss="soft_l1", f_scale=0.2, max_nfev=80)
        # further parameters have to reduce the residual considerably
        return found.cost * EXPLAINS ** (len(candidates) + (longest > NO_DELAY)), found.x

    inertia = _inertia(frequencies, mechanical)
    trials = [(*fitted(pairs, NO_DELAY), pairs) for pairs in _candidates(frequencies, mechanical)]
    score, best, pairs = min(trials, key=lambda trial: trial[0])
    delayed = fitted(pairs, LONGEST_DELAY)
    if delayed[0] < score:
        best = delayed[1]
    (inertia, viscous, delay), found = _open(best)
    decibel = 20 / math.log(10) * residual(best)[: len(frequencies)]
    return Plant(
        inertia=inertia, viscous=viscous, delay=delay, cycle=response.cycle, lag=lag, filter=share,
        resonances=tuple(
            Resonance(a, r, damping, antidamping) for a, antidamping, r, damping in sorted(found)
        ),
        error=float(np.sqrt(np.mean(decibel**2))),
    )


def _open(x: np.ndarray) -> tuple[tuple[float, float, float], list[Pair]]:
    """Split the parameters of the fit into inertia, viscous friction, delay, and pairs."""
    inertia, viscous = np.exp(x[:2]).tolist()
    rows = np.exp(x[3:]).reshape(-1, 4).tolist()
    pairs = [(row[0], row[1], row[2], row[3]) for row in rows]
    return (inertia, viscous, float(x[2]) * 1e-3), pairs


def _shares(drive: Drive, response: Response) -> tuple[float, float]:
    lag = -math.expm1(-response.cycle / max(drive.model.torque_time_constant, 1e-9))
    return lag, response.velocity_filter


def _inertia(frequencies: np.ndarray, measured: np.ndarray) -> float:
    """Estimate the inertia at the lowest frequencies, where friction has little effect."""
    low = frequencies <= 4 * frequencies[0]
    return float(np.median(1 / (2 * np.pi * frequencies * abs(measured))[low]))


def _candidates(frequencies: np.ndarray, measured: np.ndarray) -> list[list[tuple[float, float]]]:
    """Return pairs of antiresonance and resonance to try: none, the clearest one, two, …"""
    level = 20 * np.log10(abs(measured) * frequencies)
    peaks, found_peaks = scipy("signal").find_peaks(level, prominence=PROMINENCE)
    found = []
    for n, (peak, prominence) in enumerate(zip(peaks, found_peaks["prominences"], strict=True)):
        begin = int(peaks[n - 1]) if n else 0
        dip = begin + int(np.argmin(level[begin:peak]))  # the minimum before the peak
        found.append((prominence, float(frequencies[dip]), float(frequencies[peak])))
    found.sort(reverse=True)
    return [[(dip, peak) for _, dip, peak in found[:n]] for n in range(min(len(found), MOST) + 1)]
