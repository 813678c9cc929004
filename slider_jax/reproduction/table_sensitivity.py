"""Computes how single changes of the model change the values of the paper's performance table."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from slider_jax import observables as obs, paper
from slider_jax.actuation import FirstOrderLag
from slider_jax.beam.parameters import Robot, uniform_robot
from slider_jax.dynamics.model import Model, make_mesh
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects.water.head_drag import HeadDrag
from slider_jax.errors import SolverError
from slider_jax.reproduction.wavelengths import course_coordinates, rms_tail_slope, wavelengths
from slider_jax.supports import Clamped
from slider_jax.swimming.paper_optimum import HEAD_DRAG
from slider_jax.swimming.performance import Performance, Stride, steady_stride
from slider_jax.swimming.steady_state import SteadySettings

K_Q_OF_THE_TIP = 1.623e-6
"""K_Q [m^3] with which 45 kPa in both chambers move the tip by 102 mm, as the paper states. This
K_Q is 3.4 times the K_Q that follows from the paper's moment of 175 mN m at 365 kPa."""
TRANSIENT_STRIDES, MEAN_STRIDES = 12, 4
"""With a clamped head: number of first strides to skip, number of next strides to average."""


def _robot(change: Callable[[Robot], Robot]) -> Callable[[Model], Model]:
    return lambda model: replace(model, robot=change(model.robot))


def _damped(damping_time: float) -> Callable[[Robot], Robot]:
    return lambda x: x.with_parts(lambda part: replace(part, damping_time=damping_time))


def _lag(k: float) -> Callable[[Model], Model]:
    return lambda model: replace(model, pressure_law=FirstOrderLag(k))


def _effect(kind: str, **changed: Any) -> Callable[[Model], Model]:
    def change(model: Model) -> Model:
        effects = (replace(e, **changed) if e.name() == kind else e for e in model.effects)
        return replace(model, effects=tuple(effects))

    return change


def _rear_wave(**changed: Any) -> Callable[[Model], Model]:
    def change(model: Model) -> Model:
        *others, rear = model.drive.waves
        return replace(model, drive=replace(model.drive, waves=(*others, replace(rear, **changed))))

    return change


AS_STATED, NO_LAG, TIP_K_Q, SOFT_TAIL = (
    "as stated",
    "no lag of the pressures",
    "K_Q of 102 mm at 45 kPa",
    "tail of 1 mN m^2",
)
CHANGES: dict[str, Callable[[Model], Model]] = {
    AS_STATED: lambda model: model,
    NO_LAG: _lag(0.0),
    "lag k = 20 ms": _lag(0.02),
    TIP_K_Q: _robot(lambda x: replace(x, K_Q=K_Q_OF_THE_TIP)),
    "both chambers at once": _rear_wave(phase=0.0),
    "phase 0.25": _rear_wave(phase=0.25),
    "front chamber alone": _rear_wave(amplitude=0.0),
    SOFT_TAIL: _robot(lambda x: x.with_tail(EI=0.001)),
    "70 mm tail of 5.8 mN m^2": _robot(lambda x: x.with_tail(0.07, 0.0058)),
    "half the body's EI": _robot(lambda x: replace(x, body=x.body.changed(EI=0.019))),
    "twice the body's EI": _robot(lambda x: replace(x, body=x.body.changed(EI=0.076))),
    "alpha = 5e-6 s": _robot(_damped(5e-6)),
    "alpha = 10 ms": _robot(_damped(0.01)),
    "C_d = 1.2": _effect("normal_drag", C_d=1.2),
    "m_a = 0.5": _effect("reactive_force", m_a=0.5),
    "chambers over the whole body": _robot(
        lambda x: replace(x, chambers=((0.0, 0.149), (0.149, 0.298)))
    ),
    "twice the axial resistance": _effect("head_drag", area=2.0 * HEAD_DRAG),
}
"""Changes of the model for the paper's optimal gait, by name. Each change is applied alone."""
RECALIBRATED = (NO_LAG, TIP_K_Q, SOFT_TAIL)
"""Changes after which the head's form drag is fitted again to the measured speed."""


class SteadyRow(NamedTuple):
    """A steady stride of one model."""

    performance: Performance
    stride: Stride
    area: float
    """Form-drag area of the head [m^2]."""
    wavelengths: dict[str, float]
    """Wavelength [m] for each definition."""
    rms_tail_slope: float

    def slopes(self) -> dict[str, float]:
        """Returns the tail amplitude A_t divided by a quarter of each wavelength."""
        half = float(self.performance.tail_amplitude)
        return {k: float(obs.tail_slope(half, x)) for k, x in self.wavelengths.items()}


_steadily = eqx.filter_jit(steady_stride)


def _arrays(model: Model) -> Model:
    """Returns the model with numbers as arrays, so that all changes share one compiled program."""
    return jax.tree.map(lambda x: jnp.asarray(x, float), model)


def steady_row(model: Model, frequency: float, search: SteadySettings) -> SteadyRow:
    """Returns the steady stride. Raises `SolverError` if no steady stride is found."""
    model = _arrays(model)
    stride, found, ok = jax.device_get(_steadily(model, jnp.asarray(frequency, float), search))
    if not bool(ok):
        raise SolverError("no steady speed was found, or a time step did not converge")
    s = np.asarray(make_mesh(model.body, search.numerics).grid.s)
    (area,) = (float(e.area) for e in model.effects if isinstance(e, HeadDrag))
    rms = rms_tail_slope(*course_coordinates(stride))
    return SteadyRow(found, stride, area, wavelengths(stride, s, frequency), rms)


def fit_head_drag(
    model: Model, frequency: float, speed: float, search: SteadySettings
) -> SteadyRow:
    """Returns the steady stride with the head-drag area that gives `speed` [m/s] within 0.2 %.

    A secant method in the logarithms of area and speed computes the area. The first slope assumes
    that only head drag balances a constant thrust. Raises `SolverError` if no area is found.
    """
    rows: list[SteadyRow] = []
    area, power = float(next(e.area for e in model.effects if isinstance(e, HeadDrag))), -0.5
    for _ in range(12):
        rows.append(steady_row(_effect("head_drag", area=area)(model), frequency, search))
        off = np.log(float(rows[-1].performance.speed) / speed)
        if abs(off) < 2e-3:
            return rows[-1]
        if len(rows) > 1:
            before = rows[-2]
            far = np.log(float(rows[-1].performance.speed) / float(before.performance.speed))
            power = min(far / np.log(area / before.area), -0.2)
        area *= float(np.exp(np.clip(-off / power, -1.5, 1.5)))
    raise SolverError(f"no head_drag area gives {speed:g} m/s within 12 iterations")


@eqx.filter_jit
def _held(model: Model, frequency, search: SteadySettings):
    def saved(x):
        return obs.midline(x), obs.thrust(x)

    steps = search.steps_per_stride
    times = TimeGrid.per_stride(frequency, steps, TRANSIENT_STRIDES + MEAN_STRIDES)
    run = rollout(model, times, saved, search.numerics, search.scheme, checkpoint=False)
    return jax.tree.map(lambda x: x[-MEAN_STRIDES * steps :], (run.t, *run.saved)), run.ok


def clamped_performance(
    model: Model, frequency: float, tow_speed: float, search: SteadySettings
) -> dict[str, float]:
    """Returns mean thrust and shape with the head clamped and towed at `tow_speed` [m/s]."""
    model = _arrays(replace(model, support=Clamped(tow_speed=tow_speed)))
    (t, midline, thrust), ok = jax.device_get(_held(model, jnp.asarray(frequency), search))
    if not bool(ok):
        raise SolverError("a time step did not converge with the head clamped")
    y = midline[:, 1] - midline[:, 1].mean(axis=0)
    s = make_mesh(model.body, search.numerics).grid.s
    mode = obs.fundamental_mode(jnp.asarray(y), jnp.asarray(t), frequency)
    half, wavelength = 0.5 * np.ptp(y[:, 0]), float(obs.shape_wavelength(mode, s))
    return {
        "mean_thrust_N": float(thrust.mean()),
        "tail_amplitude_m": float(half),
        "shape_wavelength_m": wavelength,
        "shape_tail_slope": float(obs.tail_slope(half, wavelength)),
        "rms_tail_slope": rms_tail_slope(midline[:, 0], y),
        "travelling_index": float(obs.travelling_index(mode)),
    }


def head_fixed_thrust(
    change: str, amplitude: float, optimum: Model, search: SteadySettings
) -> float:
    """Returns the mean thrust [N] of the paper's head-fixed test at 4.8 Hz with one change."""
    f = paper.PEAK_AT
    fixed = paper.head_fixed(f, uniform_robot(), paper.Assumed(amplitude=amplitude))
    model = CHANGES[change](replace(optimum, robot=fixed.robot, drive=fixed.drive))
    return clamped_performance(model, f, 0.0, search)["mean_thrust_N"]
