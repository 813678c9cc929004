"""The residual and the Jacobian of one implicit stage: equations of cells, tail and head."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.actuation import Actuator
from slider_jax.beam.equations import (
    LocalWater,
    Reference,
    Section,
    Structure,
    equations,
    moment_law,
    section,
)
from slider_jax.beam.state import Fields, Unknowns, fields
from slider_jax.beam.waterline import Immersion
from slider_jax.dynamics.block_solver import BeamOperator, Update
from slider_jax.dynamics.shapes import Shape
from slider_jax.dynamics.tendons import couples, tendon_loads, tendons_of, tensions
from slider_jax.effects import (
    MOUNT_LAG,
    BendingMoment,
    Effect,
    HeadRates,
    Mounting,
    WakeForce,
    of_place,
    total_force,
)
from slider_jax.supports import Support


class Stage(eqx.Module):
    """The quantities that are constant while an implicit stage is solved.

    `water` contains velocity [m/s] and acceleration [m/s^2] of uniform water, each (x, y), or it is
    the water at the cells, or None for still water. `phi_head` [rad] and `load_head` are reference
    values at the head; `load_head` is the filtered load (T, N, M).
    """

    structure: Structure
    effects: tuple[Effect, ...]
    support: Support
    reference: Reference
    phi_head: Array
    load_head: Float[Array, "3"]
    pressure: Float[Array, " cells"]
    active_moment: Float[Array, " cells"]
    water: Float[Array, "2 2"] | LocalWater | None
    t: Array
    actuators: tuple[Actuator, ...] = ()
    level: Array | None = None
    """Factor of the loads of the actuators; None for 1."""
    shape: Shape | None = None
    immersion: Immersion | None = None
    """The wet part of the cells; None without a waterline."""


@eqx.filter_jit
def cell_rows(
    mid: Fields, slope: Fields, stage: Stage, tension: Array | None = None
) -> tuple[Array, ...]:
    """Returns residuals of each cell's six equations from means and slopes of the unknowns.

    `tension` (tendons,) [N] are the tensions from `tensions_of`.
    The function is compiled so that JAX traces it once, and not once for each of the tangents that
    form the Jacobian. A program with many effects then compiles faster.
    """
    x = _local(mid, slope, stage, tension)
    force, extra, _ = forces_and_states(x, stage)
    if stage.actuators:
        extra = extra - _active_moment(x, stage, tension)
    bending = moment_law(mid, x, extra - stage.active_moment)
    return equations(mid, slope, x, force, _with_shape(bending, x, stage))


def _local(mid: Fields, slope: Fields, stage: Stage, tension: Array | None) -> Section:
    """Returns the local state of the body; tendons compress the body."""
    if tension is not None:
        _, compression = tendon_loads(stage.actuators, tension, stage.structure)
        mid = mid._replace(T=mid.T - compression)
    return section(
        mid, slope, stage.structure, stage.reference, stage.water, stage.pressure, stage.t,
        stage.immersion,
    )  # fmt: skip


def _active_moment(x: Section, stage: Stage, tension: Array | None) -> Array:
    """Returns the active moment [N m] (cells,) of the actuators without the chambers."""
    moment = couples(stage.actuators, x)
    if stage.level is not None:
        moment = stage.level * moment
    if tension is None:
        return moment
    return moment + tendon_loads(stage.actuators, tension, stage.structure)[0]


def tensions_of(y: Unknowns, stage: Stage) -> Float[Array, " tendons"] | None:
    """Returns the tensions [N] of the tendons, or None if there are no tendons."""
    if not tendons_of(stage.actuators):
        return None
    mid, slope = mid_and_slope(y, stage.structure.ds)
    found = tensions(stage.actuators, mid, slope, stage.structure, stage.reference, stage.t)
    return found if stage.level is None else stage.level * found


def _with_shape(bending: Array, x: Section, stage: Stage) -> Array:
    """Returns the residual of the moment law, or of the prescribed curvature where there is one.

    The factor gives both conditions the same derivative with respect to the curvature.
    """
    if stage.shape is None:
        return bending
    factor = x.EI * (stage.reference.dt + x.damping_time)
    return jnp.where(stage.shape.cells, factor * (stage.shape.rate - x.kappa_t), bending)


def forces_and_states(
    x: Section, stage: Stage
) -> tuple[tuple[Array, Array], Array, tuple[Array, ...]]:
    """Returns the force per length (F_tau, F_n) [N/m] and the moment [N m] of all effects.

    The third value are the new states, in the order of `states_at_rest`.
    """
    F_tau, F_n = total_force(stage.effects, x)
    wakes, moments = of_place(stage.effects, WakeForce), of_place(stage.effects, BendingMoment)
    memories, dt, states = stage.reference.internal, stage.reference.dt, []
    for effect, memory in zip(wakes, memories[: len(wakes)], strict=True):
        (f_tau, f_n), state = effect.wake_force(x, memory, dt)
        if x.wet is not None:
            f_tau, f_n = x.wet * f_tau, x.wet * f_n
        F_tau, F_n = F_tau + f_tau, F_n + f_n
        states.append(state)
    moment = jnp.zeros_like(x.kappa)
    for effect, memory in zip(moments, memories[len(wakes) :], strict=True):
        part, state = effect.moment(x, memory, dt)
        moment = moment + part
        states.append(state)
    return (F_tau, F_n), moment, tuple(states)


def turning_rate(head: Fields, stage: Stage) -> Array:
    """Returns the turning rate omega [rad/s] of the head."""
    return (head.phi - stage.phi_head) / stage.reference.dt


def load_rates(head: Float[Array, "6"], stage: Stage) -> Float[Array, "3"]:
    """Returns d(load)/dt, where load + `MOUNT_LAG` d(load)/dt = (T, N, M) at the head."""
    return (head[:3] - stage.load_head) / (stage.reference.dt + MOUNT_LAG)


def head_rows(head: Float[Array, "6"], stage: Stage) -> Float[Array, "3"]:
    """Returns the residuals of the support's conditions."""
    return jnp.stack(stage.support.rows(*on_support(head, stage), stage.t))


def on_support(head: Float[Array, "6"], stage: Stage) -> tuple[Fields, Array]:
    """Returns the head's unknowns and turning rate [rad/s] without the motion of the mounting."""
    at_head, omega = fields(head), turning_rate(fields(head), stage)
    rates = HeadRates(*load_rates(head, stage))
    for effect in of_place(stage.effects, Mounting):
        tau, n, turning = effect.give(rates)
        at_head = at_head._replace(V_tau=at_head.V_tau - tau, V_n=at_head.V_n - n)
        omega = omega - turning
    return at_head, omega


def tail_rows(tail: Float[Array, "6"]) -> Float[Array, "3"]:
    """Returns the residuals at the free tail end: T = N = M = 0."""
    return tail[:3]


def mid_and_slope(y: Unknowns, ds) -> tuple[Fields, Fields]:
    """Returns the means and slopes of the six unknowns in each cell.

    Rows and factors 1/ds, and not blocks and quotients, let XLA compute the residual in one
    operation (docs/explanation/decisions.md).
    """
    left, right = [row[:-1] for row in y], [row[1:] for row in y]
    mid = (0.5 * (a + b) for a, b in zip(left, right, strict=True))
    per_length = 1.0 / ds
    slope = ((b - a) * per_length for a, b in zip(left, right, strict=True))
    return Fields(*mid), Fields(*slope)


def at_cells(y: Unknowns, stage: Stage) -> Section:
    """Returns the local state of the body in each cell."""
    return _local(*mid_and_slope(y, stage.structure.ds), stage, tensions_of(y, stage))


def residual(y: Unknowns, stage: Stage):
    """Returns the residuals ((6, cells), (3,), (3,)) of cells, tail and head."""
    mid, slope = mid_and_slope(y, stage.structure.ds)
    cells = jnp.stack(cell_rows(mid, slope, stage, tensions_of(y, stage)))
    return cells, tail_rows(y[:, 0]), head_rows(y[:, -1], stage)


def jacobian(y: Unknowns, stage: Stage) -> BeamOperator:
    """Returns the blocks of d(residual)/dy.

    The equations of a cell depend on 12 values: the means and slopes of the six unknowns. The
    values of other cells have no effect, so 12 forward tangents give all blocks of all cells. The
    tensions of elastic tendons depend on all cells; see `tendons`.
    """
    mid, slope = mid_and_slope(y, stage.structure.ds)
    tension = tensions_of(y, stage)
    values = (*mid, *slope)

    def derivative(i):
        def rows(v):
            moved = (*values[:i], v, *values[i + 1 :])
            return cell_rows(Fields(*moved[:6]), Fields(*moved[6:]), stage, tension)

        _, tangent = jax.jvp(rows, (values[i],), (jnp.ones_like(values[i]),))
        return jnp.stack(tangent)

    to_mid = 0.5 * jnp.stack([derivative(i) for i in range(6)], axis=1)
    to_slope = jnp.stack([derivative(i) for i in range(6, 12)], axis=1) / stage.structure.ds
    return BeamOperator(
        left=to_mid - to_slope,
        right=to_mid + to_slope,
        tail=jax.jacfwd(tail_rows)(y[:, 0]),
        head=jax.jacfwd(head_rows)(y[:, -1], stage),
        update=_through_tensions(y, stage),
    )


def _through_tensions(y: Unknowns, stage: Stage) -> Update | None:
    """Returns the part of the Jacobian that is due to the elongation of elastic tendons."""
    if not any(tendon.elastic for tendon in tendons_of(stage.actuators)):
        return None
    mid, slope = mid_and_slope(y, stage.structure.ds)

    def rows(tension):
        return jnp.stack(cell_rows(mid, slope, stage, tension))

    columns = jax.jacfwd(rows)(tensions_of(y, stage))
    return Update(jnp.moveaxis(columns, -1, 0), jax.jacrev(tensions_of)(y, stage))
