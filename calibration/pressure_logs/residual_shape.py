"""Computes the harmonics of a log's residual, and the mean residual in parts of the cycle."""

import math
from typing import NamedTuple

import numpy as np

from calibration.inference.intervals import noise_floor
from calibration.pressure_logs.read import ManifoldLog, psi

HARMONICS = 5
SMOOTH = 12
"""Numbers of harmonics: `HARMONICS` are reported. `SMOOTH` describe the part of the residual that
repeats in every cycle."""


class FrequencyResponse(NamedTuple):
    """Gain and phase lag [rad] at the drive frequency, and the k [s] that each value implies."""

    gain: float
    lag: float
    k_of_gain: float
    k_of_phase: float


class ResidualShape(NamedTuple):
    """Statistics [psi] of a residual (measured minus model) in the whole cycles of a log.

    `mean_share` and `harmonic_shares` are fractions of the residual's mean square. Their sum is 1
    if the residual is periodic and has no harmonic above `HARMONICS`.
    """

    rms: float
    mean: float
    mean_share: float
    harmonic_shares: tuple[float, ...]
    in_phase: float
    """Amplitude at the drive frequency, in phase with the command."""
    quadrature: float
    """Amplitude at the drive frequency, a quarter cycle behind the command."""
    not_repeating_rms: float
    """RMS of the residual minus the part that repeats in every cycle."""
    mean_filling: float
    """Mean residual while the fill valve is open (the command exceeds the measured pressure)."""
    mean_venting: float
    filling_time_share: float
    k_filling: float
    """Pressure error divided by pressure rate [s] while the fill valve is open."""
    k_venting: float
    measured: FrequencyResponse
    floor: float


def whole_cycles(log: ManifoldLog) -> np.ndarray:
    """Returns a mask (samples,) of the whole cycles. Of three or more, the first is left out."""
    cycles = math.floor(log.cycles + 0.02)
    first = 1 if cycles >= 3 else 0
    turn = log.t * log.frequency
    return (turn >= first) & (turn < max(cycles, 1))


def harmonics(t: np.ndarray, x: np.ndarray, frequency: float, count: int):
    """Returns mean, complex amplitudes (count,) and values (n,) of a Fourier series fitted to `x`.

    The harmonics are Re(c_m e^{2 pi i m f t}), m = 1 to `count`, of the frequency f [Hz].
    """
    turn = 2.0 * math.pi * frequency * t[:, None] * np.arange(1, count + 1)
    basis = np.concatenate([np.ones((len(t), 1)), np.cos(turn), np.sin(turn)], axis=1)
    c, *_ = np.linalg.lstsq(basis, x, rcond=None)
    return c[0], c[1 : count + 1] - 1j * c[count + 1 :], basis @ c


def _response(omega: float, command: complex, pressure: complex) -> FrequencyResponse:
    ratio = pressure / command
    gain, lag = abs(ratio), -float(np.angle(ratio))
    k_gain = math.sqrt(1.0 / gain**2 - 1.0) / omega if 0.0 < gain < 1.0 else math.nan
    k_phase = math.tan(lag) / omega if 0.0 < lag < 0.5 * math.pi else math.nan
    return FrequencyResponse(gain, lag, k_gain, k_phase)


def apparent_time_constants(
    t: np.ndarray, command: np.ndarray, pressure: np.ndarray
) -> tuple[float, float]:
    """Returns k [s] of dp/dt = (command - p)/k, fitted while filling and fitted while venting.

    The rate dp/dt is a central difference over 20 samples. A value of k is NaN if the mean product
    of (command - p) and rate is not positive.
    """
    rate = (pressure[20:] - pressure[:-20]) / (t[20:] - t[:-20])
    error = (command - pressure)[10:-10]

    def k(here):
        e, work = error[here], float(error[here] @ rate[here])
        return float(e @ e) / work if work > 0.0 else math.nan

    return k(error > 0.0), k(error < 0.0)


def shape_of(log: ManifoldLog, residual: np.ndarray) -> ResidualShape:
    """Returns the shape of the `residual` (samples,) [psi] of `log`."""
    here = whole_cycles(log)
    t, r = log.t[here], residual[here]
    command, pressure = psi(log.command)[here], psi(log.pressure)[here]
    square = max(float(np.mean(r**2)), 1e-300)
    mean, c, _ = harmonics(t, r, log.frequency, HARMONICS)
    _, drive, _ = harmonics(t, command, log.frequency, 1)
    _, response, _ = harmonics(t, pressure, log.frequency, 1)
    _, _, periodic = harmonics(t, r, log.frequency, SMOOTH)
    along = c[0] * drive[0].conjugate() / max(abs(drive[0]), 1e-300)
    filling = command > pressure
    k_filling, k_venting = apparent_time_constants(t, command, pressure)
    return ResidualShape(
        rms=math.sqrt(square),
        mean=float(mean),
        mean_share=float(mean**2 / square),
        harmonic_shares=tuple(float(abs(a) ** 2 / 2.0 / square) for a in c),
        in_phase=float(along.real),
        quadrature=float(-along.imag),
        not_repeating_rms=float(np.sqrt(np.mean((r - periodic) ** 2))),
        mean_filling=_mean(r[filling]),
        mean_venting=_mean(r[~filling]),
        filling_time_share=float(np.mean(filling)),
        k_filling=k_filling,
        k_venting=k_venting,
        measured=_response(2.0 * math.pi * log.frequency, drive[0], response[0]),
        floor=noise_floor(psi(log.pressure)),
    )


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else math.nan
