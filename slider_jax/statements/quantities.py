"""Simulates what the paper reports, for a set of assumptions."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax import observables as obs, paper
from slider_jax.beam.parameters import SLIDER, Numerics, Scalar
from slider_jax.dynamics.model import Model
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.effects import NormalDrag, ReactiveForce
from slider_jax.statements.assumptions import Assumptions
from slider_jax.swimming.gait import Gait
from slider_jax.swimming.paper_optimum import PAPER_GAIT
from slider_jax.swimming.performance import Performance, steady_stride
from slider_jax.swimming.steady_state import SteadySettings

STATIC_PRESSURE = 45e3
"""Pressure [Pa] in a front and a rear chamber that moves the tip by 102 mm, according to the
paper."""
TRANSIENT, AVERAGED = 3, 2
"""Numbers of head-fixed strides: those before the motion is steady, and those that are averaged."""


class StatementSettings(NamedTuple):
    """Frequencies of the head-fixed sweep, and numerical settings."""

    frequencies: tuple[float, ...]
    search: SteadySettings


COARSE = StatementSettings(
    (0.6, 0.8, 1.0, 1.2, 1.6, 2.4, 3.2, 3.8, 4.3, 4.8, 5.3, 6.0, 7.0),
    SteadySettings(
        precision=1e-5,
        corrections=12,
        steps_per_stride=60,
        numerics=Numerics(tail_cells=4, body_cells=12),
    ),
)
"""For searches: speeds differ from those with `FINE` by about 3 %."""
FINE = StatementSettings(paper.SWEEP, SteadySettings(precision=1e-7, corrections=14))
"""For tables: the mesh and the steps of `slider optimize swim`, and speeds that have converged."""


class HeadFixed(NamedTuple):
    """A head-fixed robot at one frequency."""

    thrust: Scalar
    """Mean thrust [N]."""
    recoil_share: Scalar
    """Fraction of the stride in which the recoil exceeds `paper.RECOIL_THERE`."""
    tip_half_range: Scalar
    """Half of the tip's peak-to-peak excursion [m]."""
    change: Scalar
    """Mean thrust of the last stride minus that of the first averaged stride [N]."""


def clamped_quantities(
    model: Model, frequency: Scalar, at: StatementSettings
) -> tuple[HeadFixed, Array]:
    """Returns a clamped robot's steady quantities, and whether all time steps converged."""
    steps, search = at.search.steps_per_stride, at.search
    times = TimeGrid(1.0 / (frequency * steps), steps * (TRANSIENT + AVERAGED), 0.0)

    def saved(x):
        return obs.thrust(x), obs.recoil(x), obs.tip(x)

    run = rollout(model, times, saved, search.numerics, search.scheme, checkpoint=False)
    thrust, recoil, tip = (x[steps * TRANSIENT :] for x in run.saved)
    above = jnp.mean(jnp.where(jnp.abs(recoil) > paper.RECOIL_THERE, 1.0, 0.0))
    strides = jnp.mean(thrust.reshape(AVERAGED, steps), axis=1)
    half = 0.5 * (jnp.max(tip) - jnp.min(tip))
    return HeadFixed(jnp.mean(strides), above, half, strides[-1] - strides[0]), run.ok


def _largest_pressure(assumed: Assumptions, frequency: float) -> Array:
    """Returns the pressure [Pa] of the front chamber at the end of the first half of a stride."""
    wave = assumed.head_fixed(frequency).drive.waves[0]
    return wave.at(jnp.asarray(0.5 / frequency))


def thrust_of_strides(
    model: Model, frequency: Scalar, strides: int, at: StatementSettings
) -> tuple[Float[Array, " strides"], Array]:
    """Returns a clamped robot's mean thrust [N] in each stride after the transient strides.

    The second value is whether all time steps converged.
    """
    steps, search = at.search.steps_per_stride, at.search
    times = TimeGrid(1.0 / (frequency * steps), steps * (TRANSIENT + strides), 0.0)
    run = rollout(model, times, obs.thrust, search.numerics, search.scheme, checkpoint=False)
    return jnp.mean(run.saved.reshape(-1, steps), axis=1)[TRANSIENT:], run.ok


def static_tip(assumed: Assumptions) -> Scalar:
    """Returns the lateral displacement [m] of the tip at rest with `STATIC_PRESSURE`.

    The curvature of each chamber's span is K_Q p/EI. The adapter stays straight.
    """
    robot = assumed.robot(SLIDER["tail_length"], SLIDER["EI_tail"])
    length, points = SLIDER["body_length"], 400
    x = (jnp.arange(float(points)) + 0.5) * (length / points)
    spans = [jnp.where((x > start) & (x < end), 1.0, 0.0) for start, end in robot.chambers]
    active = jnp.sum(jnp.stack(spans), axis=0)
    soft = jnp.where(x < length - assumed.adapter, 1.0, 0.0)
    bend = assumed.K_Q * STATIC_PRESSURE * active * soft / assumed.EI_body
    angle = jnp.cumsum(bend) * (length / points)
    on_body = jnp.sum(jnp.sin(angle - 0.5 * bend * (length / points))) * (length / points)
    return on_body + robot.tail.length * jnp.sin(angle[-1])


MAP_FREQUENCY, MAP_LENGTH, MAP_PHASE = 5.0, 0.06, 0.2
"""Frequency [Hz] of the design maps; tail length [m] of Fig. 7d; and the good phase."""
STIFF = float(PAPER_GAIT.EI_tail)
NEIGHBOURS = {
    "rear": (448e3,),
    "frequency": (5.6, 7.0),
    "phase": (0.07, 0.21),
    "tail_length": (0.043, 0.07),
    "EI_tail": (0.0125,),
}
"""Changes of the paper's optimum, one at a time. Its front pressure and its stiffness are the
largest allowed ones."""
PHASES = (-0.15, 0.0, 0.1, 0.15, 0.2, 0.3, 0.5)
"""Phases of the swimmers of Fig. 7d."""


def gaits(assumed: Assumptions) -> dict[str, Gait]:
    """Returns the simulated free swimmers by name."""
    p = assumed.pressure
    found = {"optimum": PAPER_GAIT}
    for field, values in NEIGHBOURS.items():
        found |= {f"{field} {x:g}": PAPER_GAIT._replace(**{field: x}) for x in values}
    slice_d = Gait(MAP_FREQUENCY, p, p, 0.0, MAP_LENGTH, SLIDER["EI_tail"])
    return found | {f"7d {x:g}": slice_d._replace(phase=x) for x in PHASES}


CHANGED = ((1.2, 1.0), (1.0, 0.8), (1.0, 0.0))
"""Factors on C_d and m_a at `paper.PEAK_AT`, to check the paper's statements on their influence."""


class Quantities(NamedTuple):
    """The simulated quantities. Values of a simulation that failed are NaN."""

    static_tip: Scalar
    """Displacement [m] of the tip by `STATIC_PRESSURE`."""
    pressure_ratio: Scalar
    """Pressure at the end of half a stride at `paper.PEAK_AT`, divided by that at 1 Hz."""
    sweep: HeadFixed
    """Head-fixed quantities (frequencies + 3,). The last three belong to `CHANGED`."""
    swims: Performance
    """Quantities (swimmers,) of the swimmers of `gaits`."""


def _with_coefficients(model: Model, drag: float, added_mass: float) -> Model:
    """Returns the model with C_d and m_a multiplied by the given factors."""
    C_d, m_a, *others = model.effects
    assert isinstance(C_d, NormalDrag) and isinstance(m_a, ReactiveForce)
    C_d, m_a = replace(C_d, C_d=drag * C_d.C_d), replace(m_a, m_a=added_mass * m_a.m_a)
    return replace(model, effects=(C_d, m_a, *others))


def quantities(assumed: Assumptions, at: StatementSettings) -> Quantities:
    """Returns all quantities for one set of assumptions; use vmap or `Evaluation` for several."""
    cases = [(f, assumed.head_fixed(f)) for f in at.frequencies]
    at_peak = assumed.head_fixed(paper.PEAK_AT)
    cases += [(paper.PEAK_AT, _with_coefficients(at_peak, *x)) for x in CHANGED]
    frequencies, fixed = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(v, float) for v in x]),
                                      *cases)  # fmt: skip
    sweep, ok = jax.vmap(lambda f, model: clamped_quantities(model, f, at))(frequencies, fixed)
    stacked = jax.tree.map(lambda *x: jnp.stack([jnp.asarray(v, float) for v in x]),
                           *gaits(assumed).values())  # fmt: skip

    def swim(gait: Gait):
        return steady_stride(assumed.swimmer(gait), gait.frequency, at.search)[1:3]

    swims, found = jax.vmap(swim)(stacked)
    return Quantities(
        static_tip(assumed),
        _largest_pressure(assumed, paper.PEAK_AT) / _largest_pressure(assumed, 1.0),
        jax.tree.map(lambda x: jnp.where(ok, x, jnp.nan), sweep),
        jax.tree.map(lambda x: jnp.where(found, x, jnp.nan), swims),
    )
