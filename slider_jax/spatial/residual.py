"""The residual and the Jacobian of one implicit stage in three dimensions.

The unknowns per node are T, M, V and theta. theta [rad] is the rotation vector from the frame at
the start of the step to the present frame. The frame is stored between the steps, so the rotation
in a step stays small and no singularity of a rotation vector can occur.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slider_jax.beam.spatial import (
    Quaternion,
    SpatialFields,
    SpatialReference,
    SpatialSection,
    SpatialStructure,
    Turning,
    Vec,
    equations_in_space,
    rate_of,
    rotation_vector,
    section_in_space,
    strain_in_space,
    turned,
    turning_of,
)
from slider_jax.dynamics.block_solver import BeamOperator, Update
from slider_jax.effects import Effect, total_load
from slider_jax.spatial.lines import ChamberLines, TendonLines
from slider_jax.supports import Support


class SpatialStage(eqx.Module):
    """The quantities that are constant while a stage is solved.

    `frame` (4, nodes) are the quaternions at the start of the step. `theta` (3, nodes) [rad] are
    the reference values of theta. `water` contains velocity [m/s] and acceleration [m/s^2] of the
    water, each (x, y, z). It is None for still water.
    """

    structure: SpatialStructure
    effects: tuple[Effect, ...]
    support: Support
    reference: SpatialReference
    frame: Quaternion
    theta: Vec
    active_moment: Vec
    water: Float[Array, "2 3"] | None
    t: Array
    tendons: TendonLines | None = None
    chambers: ChamberLines | None = None
    """Chambers whose moment depends on the strains; `active_moment` is that of all others."""


def vectors(y: Float[Array, "rows n"]) -> list[Vec]:
    """Returns the vectors in `y`, three rows for each; the unknowns are T, M, V and theta."""
    return [Vec(*y[i : i + 3]) for i in range(0, len(y), 3)]


def at(tree, where):
    """Returns the entries `where` along the last axis of every array."""
    return jax.tree.map(lambda x: x[..., where], tree)


_keep = jax.lax.optimization_barrier
LEFT, RIGHT = slice(None, -1), slice(1, None)


def frame_and_omega(theta: Vec, stage: SpatialStage, where=slice(None)) -> tuple[Quaternion, Vec]:
    """Returns frame and omega [rad/s] of the nodes `where` from their theta [rad]."""
    rate = theta.minus(at(stage.theta, where)).times(1.0 / stage.reference.dt)
    return at(stage.frame, where).after(turned(theta)), turning_of(theta, rate)


def turning_in_cells(theta: Vec, stage: SpatialStage) -> Turning:
    """Returns the rotations in the cells from theta at the nodes."""
    frame, omega = frame_and_omega(theta, stage)
    (p, before), (q, after) = (at((frame, omega), where) for where in (LEFT, RIGHT))
    turn = rotation_vector(p.inverse().after(q))
    per_length = 1.0 / stage.structure.ds
    mean, curvature = before.plus(after).times(0.5), turn.times(per_length)
    slope = after.minus(before).times(per_length)
    middle = p.after(turned(turn.times(0.5)))
    return Turning(mean, curvature, slope.plus(curvature.cross(mean)), middle)


def means_and_slopes(y: Float[Array, "12 nodes"], ds) -> tuple[SpatialFields, SpatialFields]:
    """Returns means and slopes of T, M and V in each cell."""
    left, right = y[:9, :-1], y[:9, 1:]
    mean, slope = 0.5 * (left + right), (right - left) / ds
    return SpatialFields(*vectors(mean)), SpatialFields(*vectors(slope))


@eqx.filter_jit
def spatial_cell_rows(
    mid: SpatialFields,
    slope: SpatialFields,
    turning: Turning,
    stage: SpatialStage,
    tension: Array | None = None,
) -> tuple[Array, ...]:
    """Returns the residuals of the twelve equations of each cell.

    `tension` (tendons,) [N] are the tensions from `tensions_in_space`.
    """
    x = _section(mid, slope, turning, stage, tension)
    load, active = total_load(stage.effects, x), moment_of_chambers(x, stage)
    if tension is not None and stage.tendons is not None:
        active = active.plus(stage.tendons.loads(tension, x.strain, x.curvature)[1])
    return equations_in_space(mid, slope, x, stage.reference, active, load)


def moment_of_chambers(x: SpatialSection, stage: SpatialStage) -> Vec:
    """Returns the active moment [N m] of the chambers in the cells."""
    if stage.chambers is None:
        return stage.active_moment
    return stage.active_moment.plus(stage.chambers.moment(x.strain, x.curvature))


def _section(mid, slope, turning, stage: SpatialStage, tension: Array | None) -> SpatialSection:
    """Returns the local state of the body; tendons compress the body."""
    if tension is not None and stage.tendons is not None:
        strain = _strain(mid.T.tau, turning.curvature, stage, tension)
        compression, _ = stage.tendons.loads(tension, strain, turning.curvature)
        mid = mid._replace(T=mid.T._replace(tau=mid.T.tau - compression))
    return section_in_space(
        mid, slope, turning, stage.structure, stage.reference, stage.water, stage.t
    )


def _strain(T: Array, curvature: Vec, stage: SpatialStage, tension: Array | None) -> Array:
    """Returns the strain [-] in the cells at the net axial force `T` [N]."""
    if tension is None or stage.tendons is None:
        return strain_in_space(T, stage.structure, stage.reference)
    return stage.tendons.strain(tension, T, curvature, stage.structure, stage.reference)


def tensions_in_space(
    T: Array, curvature: Vec, stage: SpatialStage
) -> Float[Array, " tendons"] | None:
    """Returns the tensions [N] of the tendons at the net axial force `T` [N] and the `curvature`
    [1/m] in the cells, or None if there are no tendons."""
    if stage.tendons is None:
        return None
    return stage.tendons.tensions(T, curvature, stage.structure, stage.reference, stage.t)


def sections(y: Float[Array, "12 nodes"], stage: SpatialStage) -> SpatialSection:
    """Returns the local state of the body in each cell."""
    theta = vectors(y)[3]
    turning = turning_in_cells(theta, stage)
    mid, slope = means_and_slopes(y, stage.structure.ds)
    tension = tensions_in_space(mid.T.tau, turning.curvature, stage)
    return _section(mid, slope, turning, stage, tension)


def head_conditions(head: Float[Array, "12"], stage: SpatialStage) -> Float[Array, "6"]:
    """Returns the residuals of the support's conditions."""
    T, M, V, theta = vectors(head)
    return _head_rows(SpatialFields(T, M, V), *frame_and_omega(theta, stage, -1), stage)


def _head_rows(at_head: SpatialFields, frame: Quaternion, omega: Vec, stage: SpatialStage):
    return jnp.stack(stage.support.rows_in_space(at_head, frame, omega, stage.t))


def spatial_residual(y: Float[Array, "12 nodes"], stage: SpatialStage):
    """Returns the residuals ((12, cells), (6,), (6,)) of cells, tail and head."""
    theta = vectors(y)[3]
    turning = turning_in_cells(theta, stage)
    mid, slope = means_and_slopes(y, stage.structure.ds)
    tension = tensions_in_space(mid.T.tau, turning.curvature, stage)
    cells = spatial_cell_rows(mid, slope, turning, stage, tension)
    return _stacked(cells), y[:6, 0], head_conditions(y[:, -1], stage)


def _stacked(rows: tuple[Array, ...]) -> Float[Array, "rows cells"]:
    """Returns the same as `jnp.stack`, in a form that XLA compiles to one loop.

    `jnp.stack` gives a loop for each row, and each loop computes the section again. A step of one
    robot then takes 1.4 times as long (docs/explanation/decisions.md).
    """
    index = jnp.arange(len(rows))[:, None]
    found = jnp.broadcast_to(rows[-1], (len(rows), *rows[-1].shape))
    for i, row in enumerate(rows[:-1]):
        found = jnp.where(index == i, row, found)
    return found


def _each_component(like: Array) -> Vec:
    """Returns the three unit vectors at every entry of `like`; the first axis counts them."""
    unit = jnp.eye(3, dtype=like.dtype)
    return Vec(*jnp.broadcast_to(unit[..., None], (3, 3, *like.shape)))


def _moved(frame: Quaternion, small: Vec) -> Quaternion:
    """Returns the frame after a rotation by `small` [rad], to first order."""
    return frame.after(Quaternion(jnp.ones_like(frame.w), *small.times(0.5)))


def _by_theta(
    theta: Vec, turning: Turning, stage: SpatialStage
) -> tuple[Vec, Vec, tuple[Vec, Vec, Vec, Vec]]:
    """Returns the derivatives by theta: (3, nodes) at the nodes, and (6, cells) in the cells.

    At the nodes, they are the small rotations psi of the frames and the derivatives of omega. In
    the cells, they are those of omega, Omega and dOmega/dt, and the small rotation of the middle,
    by theta at the left node (the first three) and at the right node.

    A change of theta turns the frame of its node by psi = `turning_of`(theta, change). The turn v
    between the two nodes of a cell then changes by rate_of(v, psi_right) - rate_of(-v, psi_left).
    """
    units = _each_component(theta.tau)
    psi = turning_of(theta, units)
    along = jax.vmap(lambda d: jax.jvp(lambda x: frame_and_omega(x, stage)[1], (theta,), (d,))[1])
    omega = along(units)
    per_length = 1.0 / stage.structure.ds
    turn = turning.curvature.times(stage.structure.ds)
    half = turn.times(0.5)
    before, after = at(psi, LEFT), at(psi, RIGHT)
    left = rate_of(turn.times(-1.0), before).times(-1.0)
    right = rate_of(turn, after)
    in_middle = turned(half).to_frame(jnp.stack(before))
    small = turning_of(half, left.times(0.5)).plus(in_middle), turning_of(half, right.times(0.5))
    sides = []
    for sign, where, v, m in zip((-1.0, 1.0), (LEFT, RIGHT), (left, right), small, strict=True):
        w = at(omega, where)
        by_mean, by_curvature = w.times(0.5), v.times(per_length)
        crossed = by_curvature.cross(turning.omega).plus(turning.curvature.cross(by_mean))
        sides.append((by_mean, by_curvature, w.times(sign * per_length).plus(crossed), m))
    return psi, omega, jax.tree.map(lambda a, b: jnp.concatenate([a, b]), *sides)


def _by_loads(
    strain: Array, curvature: Vec
) -> tuple[Float[Array, "12 5 cells"], Float[Array, "12 6 cells"]]:
    """Returns the derivatives by the means of T_n, T_b and M, and by the slopes of T and M."""
    one = jnp.ones_like(curvature.tau)
    zero = 0.0 * one
    # Columns of the matrix of -(Omega x).
    along = [zero, -curvature.b, curvature.n]
    across = [curvature.b, zero, -curvature.tau]
    upward = [-curvature.n, curvature.tau, zero]
    stretch = 1.0 + strain
    none, units = [zero] * 3, [[one, zero, zero], [zero, one, zero], [zero, zero, one]]
    means = [
        [*none, *none, *across, zero, zero, -stretch],
        [*none, *none, *upward, zero, stretch, zero],
        *([*none, *u, *none, *m] for u, m in zip(units, (along, across, upward), strict=True)),
    ]
    slopes = [[*none, *none, *(-x for x in u), *none] for u in units]
    slopes += [[*none, *none, *none, *(-x for x in u)] for u in units]
    by_means, by_slopes = (
        jnp.stack([jnp.stack(column) for column in x], axis=1) for x in (means, slopes)
    )
    return by_means, by_slopes


def spatial_jacobian(y: Float[Array, "12 nodes"], stage: SpatialStage) -> BeamOperator:
    """Returns the blocks of d(residual)/dy.

    The rows depend on means and slopes of T, M and V, and through omega, Omega, dOmega/dt and the
    frame on theta at the two nodes of the cell. `_by_loads` knows the derivatives by T and M,
    except the one by the axial force, which changes the strain. The others are those of
    `spatial_cell_rows` along each of V, dV/ds and theta alone, so terms without them cost nothing.
    """
    ds = stage.structure.ds
    mid, slope = means_and_slopes(y, ds)
    theta = vectors(y)[3]
    turning = turning_in_cells(theta, stage)
    tension = tensions_in_space(mid.T.tau, turning.curvature, stage)
    psi, omega_by_theta, by_theta = _keep(_by_theta(theta, turning, stage))

    def derivative(function, values, directions) -> Float[Array, "12 n cells"]:
        return jnp.stack(jax.vmap(lambda d: jax.jvp(function, (values,), (d,))[1])(directions))

    def rows(mid, slope, turning, tension=tension):
        return spatial_cell_rows(mid, slope, turning, stage, tension)

    def by_tension(tension):
        return rows(mid, slope, turning, tension)

    def by_axial_force(T_tau):
        return rows(mid._replace(T=mid.T._replace(tau=T_tau)), slope, turning)

    def by_velocity(V):
        return rows(mid._replace(V=V), slope, turning)

    def by_slope(V_s):
        return rows(mid, slope._replace(V=V_s), turning)

    def by_turning(values):
        *rates, small = values
        return rows(mid, slope, Turning(*rates, _moved(turning.frame, small)))

    one = jnp.ones((1, *ds.shape), ds.dtype)
    each, zero = _each_component(ds), jnp.zeros_like(ds)
    rotations = (turning.omega, turning.curvature, turning.curvature_t, Vec(zero, zero, zero))
    of_axial_force = derivative(by_axial_force, mid.T.tau, one)
    of_velocity = derivative(by_velocity, mid.V, each)
    of_slope = derivative(by_slope, slope.V, each)
    of_theta = derivative(by_turning, rotations, by_theta)
    strain = _strain(mid.T.tau, turning.curvature, stage, tension)
    of_loads, of_their_slopes = _by_loads(strain, turning.curvature)
    to_mid = jnp.concatenate([of_axial_force, of_loads, of_velocity], axis=1)
    to_slope = jnp.concatenate([of_their_slopes, of_slope], axis=1)
    from_mid, from_slope = 0.5 * to_mid, to_slope / ds
    return BeamOperator(
        left=jnp.concatenate([from_mid - from_slope, of_theta[:, :3]], axis=1),
        right=jnp.concatenate([from_mid + from_slope, of_theta[:, 3:]], axis=1),
        tail=jnp.eye(6, 12, dtype=y.dtype),
        head=_head_jacobian(y[:, -1], at((psi, omega_by_theta), -1), stage),
        update=_through_tensions(y, by_tension, stage),
    )


def _head_jacobian(
    head: Float[Array, "12"], by_theta: tuple[Vec, Vec], stage: SpatialStage
) -> Float[Array, "6 12"]:
    """Returns the derivatives of `head_conditions`; `by_theta` are psi and those of omega."""
    T, M, V, theta = vectors(head)
    frame, omega = frame_and_omega(theta, stage, -1)

    def rows(loads_and_velocity, small, omega):
        at_head = SpatialFields(*vectors(loads_and_velocity))
        return _head_rows(at_head, _moved(frame, Vec(*small)), Vec(*omega), stage)

    values = head[:9], jnp.zeros(3, head.dtype), jnp.stack(omega)
    direct, by_frame, by_omega = jax.jacfwd(rows, argnums=(0, 1, 2))(*values)
    psi, spin = (jnp.stack(x) for x in by_theta)
    return jnp.concatenate([direct, by_frame @ psi + by_omega @ spin], axis=1)


def _through_tensions(
    y: Float[Array, "12 nodes"], rows: Callable[[Array], tuple[Array, ...]], stage: SpatialStage
) -> Update | None:
    """Returns the part of the Jacobian that is due to the elongation of elastic tendons.

    `rows` returns the residuals of the cells at given tensions.
    """
    if stage.tendons is None or not stage.tendons.elastic:
        return None

    def tensions(y):
        mid, _ = means_and_slopes(y, stage.structure.ds)
        curvature = turning_in_cells(vectors(y)[3], stage).curvature
        return tensions_in_space(mid.T.tau, curvature, stage)

    tension, back = jax.vjp(tensions, y)
    columns = jax.jacfwd(lambda x: jnp.stack(rows(x)))(tension)
    (by_y,) = jax.vmap(back)(jnp.eye(len(tension), dtype=y.dtype))
    return Update(jnp.moveaxis(columns, -1, 0), by_y)
