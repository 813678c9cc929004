"""Fits the damping time alpha to a ring-down of the robot, released from a bent shape in air.

A small oscillation of a Kelvin-Voigt beam with angular frequency omega decays as exp(-alpha omega^2
t/2) in the time t. This decay gives an initial value of alpha. The fit to the whole record has six
parameters: alpha, a factor on both stiffnesses, the load before the release, the drag coefficient
in air with the prior `AIR_DRAG`, the time of release, and the ruler's zero reading.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import curve_fit

from calibration.bench.statics import BenchEstimate, levenberg_marquardt, undriven_robot
from calibration.bench.tables import Bench, RingDown
from calibration.inference.intervals import correlation_time
from slider_jax import observables as obs
from slider_jax.beam.parameters import Numerics, Robot
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.statics import Loads, at_rest_under, release
from slider_jax.effects import NormalDrag
from slider_jax.errors import InputError
from slider_jax.experiment.prepare import StepGrid
from slider_jax.simulation.trial import run_chunks

AIR_DRAG = (2.0, 0.7)
"""Mean and standard deviation of the prior on C_d, the drag coefficient of the cross-flow in air.
A plate in steady flow has C_d = 2. Oscillations with a small stroke increase C_d."""
STEPS = 200
"""Number of time steps per period of the first mode."""
BLOCK = 1000
"""Number of time steps per call of the compiled function. All records use the same function."""
MIN_DAMPING = 1e-6
"""Smallest initial value of alpha [s]."""


class Decay(NamedTuple):
    """Fit of a cosine whose amplitude decays as exp(-rate t), plus a constant, to a record."""

    frequency: float
    """Frequency of the oscillation [Hz]."""
    rate: float
    """Decay rate of the amplitude [1/s]."""

    @property
    def damping_time(self) -> float:
        """Returns alpha [s] of a Kelvin-Voigt mode with this decay: 2 rate/(2 pi frequency)^2."""
        return 2.0 * self.rate / (2.0 * np.pi * self.frequency) ** 2


class RingFit(NamedTuple):
    """The fit of a ring-down."""

    damping_time: BenchEstimate
    """Damping time alpha [s]."""
    stiffness: BenchEstimate
    """Factor on EI_body and EI_tail that gives the measured frequency; 1 if both are correct."""
    decay: Decay
    predicted: np.ndarray
    """Predicted tip (n,) [m] at the record's times."""
    noise: float
    """Standard deviation of the tip's noise [m]."""
    mean_square: float
    """Mean square of the residual, after division by the noise's standard deviation."""
    load: float
    """Lateral force on the tail's end before the release [N]."""
    converged: bool


def fit_decay(t: np.ndarray, tip: np.ndarray) -> Decay:
    """Returns frequency and decay rate of the first mode; the record's first period is not used.

    Raises `InputError` if the record does not oscillate.
    """
    x = tip - tip.mean()
    spectrum = np.abs(np.fft.rfft(x * np.hanning(len(x)), 8 * len(x)))
    frequency = np.fft.rfftfreq(8 * len(x), t[1] - t[0])[int(np.argmax(spectrum[8:])) + 8]
    late = t > t[0] + 1.0 / frequency
    size = 0.5 * float(np.ptp(x))

    def cosine(s, a, b, rate, f, zero):
        turn = 2.0 * np.pi * f * s
        return np.exp(-rate * s) * (a * np.cos(turn) + b * np.sin(turn)) + zero

    try:
        found, _ = curve_fit(
            cosine, t[late], tip[late], (size, 0.0, 0.1 * frequency, frequency, tip.mean())
        )
    except RuntimeError:
        found = np.full(5, np.nan)
    residual = np.std(tip[late] - cosine(t[late], *found))
    if not residual < 0.5 * np.std(tip[late]):
        raise InputError(
            f"the ring-down has no decaying oscillation near {frequency:.3g} Hz: the residual of a "
            "fitted damped cosine must be below half of the signal; record from the release on"
        )
    return Decay(float(found[3]), float(found[2]))


def _model(theta, robot: Robot, density):
    """Returns the robot in air for theta = (log alpha, log stiffness, load, C_d in air)."""
    alpha, stiffness = jnp.exp(theta[0]), jnp.exp(theta[1])
    bent = robot.with_parts(lambda part: replace(part, damping_time=alpha, EI=part.EI * stiffness))
    return replace(undriven_robot(bent), effects=(NormalDrag(theta[3], density),))


@eqx.filter_jit
def _begin(theta, directions, robot: Robot, density, numerics: Numerics):
    """Returns the released robot's state and tip, and their tangents along `directions`."""

    def carry(theta):
        model = _model(theta, robot, density)
        loads = Loads(jnp.stack([jnp.zeros_like(theta[2]), theta[2]]), jnp.zeros(2))
        held = at_rest_under(model, loads, numerics)
        return release(model, held, numerics), held.shape[1, 0]

    return _with_tangents(carry, (theta,), (directions,))


@eqx.filter_jit
def _advance(theta, carry, d_theta, d_carry, robot, density, h, t0, numerics: Numerics):
    """Returns the state after `BLOCK` more steps, the tip (BLOCK,) [m], and their tangents."""

    def run(theta, carry):
        times = TimeGrid(h, BLOCK, t0)
        model = _model(theta, robot, density)
        out = rollout(model, times, obs.tip, numerics, begin=carry, checkpoint=False)
        return out.final, jnp.where(out.final.ok, out.saved, jnp.nan)

    return _with_tangents(run, (theta, carry), (d_theta, d_carry))


def _with_tangents(function: Callable, arguments, directions):
    dynamic, static = eqx.partition(arguments, eqx.is_inexact_array)

    def value(dynamic):
        out = function(*eqx.combine(dynamic, static))
        return eqx.filter(out, eqx.is_inexact_array), out

    def along(d):
        _, tangent, out = jax.jvp(value, (dynamic,), (d,), has_aux=True)
        return out, tangent

    return jax.vmap(along, out_axes=(None, 0))(directions)


def _series(theta: np.ndarray, robot, density: float, grid: StepGrid, numerics: Numerics):
    """Returns the tip (n + 1,) [m] since the release, and its tangents (4, n + 1)."""
    x, d, rho = jnp.asarray(theta), jnp.eye(len(theta)), jnp.asarray(density)
    (carry, tip), (d_carry, d_tip) = _begin(x, d, robot, rho, numerics)
    h = jnp.asarray(grid.h)

    def advance(done: int, state):
        carry, d_carry = state
        t0 = jnp.asarray(grid.h * done)
        (carry, tip), (d_carry, d_tip) = _advance(x, carry, d, d_carry, robot, rho, h, t0, numerics)
        return (tip, d_tip), (carry, d_carry)

    parts, _ = run_chunks(advance, (carry, d_carry), grid.steps, BLOCK)
    values, slopes = zip((tip[None], d_tip[:, None]), *parts, strict=True)
    return np.concatenate(values), np.concatenate(slopes, axis=1)


def fit_ring_down(
    bench: Bench, robot: Robot | None = None, numerics: Numerics = Numerics()
) -> RingFit:
    """Returns the fit of alpha to the bench's ring-down; `robot` gives the initial values.

    If no noise is declared, the residual's standard deviation is used as noise. The residual is
    correlated, so the variances are multiplied by its correlation time (in samples).
    """
    record = bench.ring_down
    assert record is not None
    robot = jax.tree.map(lambda x: jnp.asarray(x, float), robot or bench.robot)
    decay = fit_decay(record.t, record.tip)
    h = 1.0 / (decay.frequency * STEPS)
    blocks = int(np.ceil((record.t[-1] + 0.25 / decay.frequency) / (h * BLOCK)))
    grid = StepGrid(h, BLOCK * blocks)
    density = record.air_density
    at = grid.times

    def predicted(x):
        """Returns the tip at the record's times and its tangents for x = (theta, delay, zero)."""
        value, slope = _series(x[:4], robot, density, grid, numerics)
        t = record.t - x[4]
        rate = np.where(t < 0.0, 0.0, np.interp(t, at, np.gradient(value, grid.h)))
        columns = [np.interp(t, at, s) for s in slope] + [-rate, np.ones_like(t)]
        return np.interp(t, at, value) + x[5], np.stack(columns, axis=1)

    def linearised(noise):
        def function(x):
            y, J = predicted(x)
            prior = np.zeros(6)
            prior[3] = 1.0 / AIR_DRAG[1]
            r = np.append((y - record.tip) / noise, (x[3] - AIR_DRAG[0]) / AIR_DRAG[1])
            return r, np.concatenate([J / noise, prior[None]])

        return function

    noise = record.noise or 0.02 * float(np.std(record.tip))
    start = _start(record, decay, robot, density, grid, numerics)
    least = levenberg_marquardt(linearised(noise), start)
    if record.noise is None:
        noise = max(float(np.std(least.residual[:-1])) * noise, 1e-7)
        least = levenberg_marquardt(linearised(noise), least.x)
    residual = least.residual[:-1]
    square = float(residual @ residual) / (len(residual) - 5)
    widening = max(1.0, square) * max(1.0, correlation_time(residual))
    error = np.sqrt(widening * np.diag(least.inverse))
    values = np.exp(least.x[:2])
    alpha, stiffness = (
        BenchEstimate.of(float(v), float(v * e), 1.96) for v, e in zip(values, error, strict=False)
    )
    return RingFit(
        damping_time=alpha,
        stiffness=stiffness,
        decay=decay,
        predicted=predicted(least.x)[0],
        noise=noise,
        mean_square=square,
        load=float(least.x[2]),
        converged=least.converged,
    )


def _start(record: RingDown, decay: Decay, robot, density, grid, numerics) -> np.ndarray:
    """Returns initial parameters that give the record's first tip, frequency and decay.

    The function simulates twice, and corrects the parameters after each simulation.
    """
    length, EI = float(robot.length), float(robot.body.effective_EI)
    first = float(np.mean(record.tip[: max(2, len(record.tip) // 200)]) - np.mean(record.tip))
    alpha = max(decay.damping_time, MIN_DAMPING)
    theta = np.array([np.log(alpha), 0.0, 3.0 * EI * first / length**3, AIR_DRAG[0]])
    for _ in range(2):
        tip, _ = _series(theta, robot, density, grid, numerics)
        t = grid.h * np.arange(len(tip))
        seen = t <= record.t[-1]
        found = fit_decay(t[seen], tip[seen])
        factor = (decay.frequency / found.frequency) ** 2
        theta[1] += np.log(factor)
        theta[2] *= factor * first / tip[0]
    wanted = np.exp(theta[0]) + decay.damping_time - found.damping_time
    theta[0] = np.log(max(wanted, MIN_DAMPING))
    return np.r_[theta, 0.0, float(np.mean(record.tip))]
