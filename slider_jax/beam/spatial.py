"""The equations of a beam in space in one cell: rotations, geometry, and balances.

The frame of a section has the axes tau (towards the head), n and b = tau x n. Vectors are given by
their components in this frame. A planar beam moves along tau and n and turns about b.

    d(eps)/dt tau + (1 + eps) omega x tau = dV/ds + Omega x V                  (stretch and turn)
    d(Omega)/dt                           = d(omega)/ds + Omega x omega        (bend and twist)
    M = K (Omega + alpha d(Omega)/dt) - M_act,  K = (GJ, EI_n, EI_b)           (moment law)
    m (dV/dt + omega x V)                 = dT/ds + Omega x T + (1 + eps) F    (force)
    J d(omega)/dt + omega x (J omega)     = dM/ds + Omega x M + (1 + eps) (tau x T + C)   (moment)

T is the force, M the moment, V the velocity, Omega the curvature vector, omega the rate of turning,
J the moments of inertia per length, and F and C are force and couple per length. EI_n resists
bending about n, and EI_b bending about b. In the plane, these are the equations of `equations`.

Source: Simo, J. C. and Vu-Quoc, L. (1988), On the dynamics in space of rods undergoing large
motions, Comput. Methods Appl. Mech. Eng. 66, 125-161, without shear strain.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Vec(NamedTuple):
    """A vector by its components in the frame of a section. The components have one shape."""

    tau: Array
    n: Array
    b: Array

    def plus(self, other: "Vec") -> "Vec":
        return Vec(*(x + y for x, y in zip(self, other, strict=True)))

    def minus(self, other: "Vec") -> "Vec":
        return Vec(*(x - y for x, y in zip(self, other, strict=True)))

    def times(self, factor) -> "Vec":
        return Vec(*(x * factor for x in self))

    def cross(self, other: "Vec") -> "Vec":
        a, b = self, other
        return Vec(a.n * b.b - a.b * b.n, a.b * b.tau - a.tau * b.b, a.tau * b.n - a.n * b.tau)


class Quaternion(NamedTuple):
    """A unit quaternion w + x i + y j + z k; it turns the axes of space into those of a frame."""

    w: Array
    x: Array
    y: Array
    z: Array

    def after(self, q: "Quaternion") -> "Quaternion":
        """Returns the product of this quaternion and `q`: `q` turns about the axes of the frame."""
        p = self
        return Quaternion(
            p.w * q.w - p.x * q.x - p.y * q.y - p.z * q.z,
            p.w * q.x + p.x * q.w + p.y * q.z - p.z * q.y,
            p.w * q.y - p.x * q.z + p.y * q.w + p.z * q.x,
            p.w * q.z + p.x * q.y - p.y * q.x + p.z * q.w,
        )

    def inverse(self) -> "Quaternion":
        return Quaternion(self.w, -self.x, -self.y, -self.z)

    def axes(self) -> tuple[Vec, Vec, Vec]:
        """Returns the components of the x, y and z axis of space in the frame."""
        w, x, y, z = self
        return (
            Vec(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            Vec(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            Vec(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )

    def to_frame(self, vector: Float[Array, "3 ..."]) -> Vec:
        """Returns the components in the frame of a vector (x, y, z) in space."""
        x, y, z = (axis.times(v) for axis, v in zip(self.axes(), vector, strict=True))
        return x.plus(y).plus(z)

    def to_space(self, vector: Vec) -> Float[Array, "3 ..."]:
        """Returns (x, y, z) of a vector that is given in the frame."""
        return jnp.stack(
            [sum(p * q for p, q in zip(axis, vector, strict=True)) for axis in self.axes()]
        )


def about_tau(angle: Array) -> Quaternion:
    """Returns the quaternion of a roll by `angle` [rad] about tau."""
    half, zero = 0.5 * angle, jnp.zeros_like(angle)
    return Quaternion(jnp.cos(half), jnp.sin(half), zero, zero)


def about_b(angle: Array) -> Quaternion:
    """Returns the quaternion of a turn by `angle` [rad] about b."""
    half, zero = 0.5 * angle, jnp.zeros_like(angle)
    return Quaternion(jnp.cos(half), zero, zero, jnp.sin(half))


def unit(q: Quaternion) -> Quaternion:
    """Returns the quaternion divided by its norm."""
    scale = 1.0 / jnp.sqrt(q.w**2 + q.x**2 + q.y**2 + q.z**2)
    return Quaternion(*(component * scale for component in q))


def _series(x: Array, ratios: tuple[float, ...]) -> Array:
    """Returns 1 + r_1 x (1 + r_2 x (1 + ...)) with the `ratios` r of successive terms."""
    total = jnp.ones_like(x)
    for ratio in reversed(ratios):
        total = 1.0 + ratio * x * total
    return total


def _factorials(first: int) -> tuple[float, ...]:
    """Returns the ratios of the terms (-x)^k first!/(2 k + first)!."""
    return tuple(-1.0 / ((first + 2 * k - 1) * (first + 2 * k)) for k in range(1, 11))


_COSINE, _SINE, _SECOND, _THIRD = (_factorials(first) for first in range(4))
"""cos(a), sin(a)/a, 2 (1 - cos a)/a^2 and 6 (a - sin a)/a^3 as series in a^2.

For angles up to 2 rad, the error is a rounding error. A series has no singular point at zero, where
the closed forms divide by zero, and costs less than a sine.
"""
_ARCSINE = tuple((2 * k - 1) ** 2 / (2 * k * (2 * k + 1)) for k in range(1, 12))
"""asin(s)/s as a series in s^2."""


def _square(v: Vec) -> Array:
    return v.tau * v.tau + v.n * v.n + v.b * v.b


def turned(v: Vec) -> Quaternion:
    """Returns the quaternion of the rotation vector `v` [rad], for angles up to pi."""
    x = 0.25 * _square(v)
    return Quaternion(_series(x, _COSINE), *v.times(0.5 * _series(x, _SINE)))


def rotation_vector(q: Quaternion) -> Vec:
    """Returns the rotation vector [rad] of a quaternion, for angles up to 2 rad."""
    # Two half angles: with sin(a/8), the series of the arc sine converges fast.
    v = Vec(q.x, q.y, q.z)
    half = jnp.sqrt(0.5 * (1.0 + q.w))
    quarter = jnp.sqrt(0.5 * (1.0 + half))
    scale = 0.25 / (half * quarter)
    return v.times(8.0 * scale * _series(_square(v) * scale**2, _ARCSINE))


def turning_of(v: Vec, rate: Vec) -> Vec:
    """Returns the rate of turning omega, in the turned frame, of a rotation vector `v` [rad].

    omega = rate - (1 - cos a)/a^2 v x rate + (a - sin a)/a^3 v x (v x rate), with a = |v|. The
    angle a may be up to 2 rad.
    """
    x = _square(v)
    across = v.cross(rate)
    twice = v.cross(across).times(_series(x, _THIRD) / 6.0)
    return rate.minus(across.times(0.5 * _series(x, _SECOND))).plus(twice)


_BERNOULLI = (1 / 60, 1 / 42, 1 / 40, 5 / 198, 691 / 27300, 210 / 8292, 3617 / 142800)
"""12 (1 - (a/2) cot(a/2))/a^2 as a series in a^2; the later ratios are 1/(4 pi^2)."""


def rate_of(v: Vec, omega: Vec) -> Vec:
    """Returns the rate of a rotation vector `v` [rad] from omega: the inverse of `turning_of`."""
    across = v.cross(omega)
    c = _series(_square(v), (*_BERNOULLI, *[1.0 / (4.0 * jnp.pi**2)] * 7)) / 12.0
    return omega.plus(across.times(0.5)).plus(v.cross(across).times(c))


class SpatialStructure(eqx.Module):
    """Properties of a robot in space in its cells, in SI units.

    Arrays have the shape (cells,). Vectors have the components along tau, n and b.
    """

    linear_density: Array
    inertia: Vec
    """Moments of inertia per length [kg m]; the one about tau is positive."""
    stiffness: Vec
    """GJ, EI_n and EI_b [N m^2]."""
    EA: Array
    damping_time: Array
    height: Array
    """Size H [m] of the section along b."""
    height_s: Array
    width: Array
    """Size W [m] of the section along n."""
    width_s: Array
    s: Array
    ds: Array
    in_tail: Array
    joint: Array
    area: Array | None = None
    """Volume of displaced water per length [m^2]; None without buoyancy."""


class SpatialFields(NamedTuple):
    """The unknowns by name: values at nodes, or means or slopes d/ds in cells."""

    T: Vec
    """Force [N]."""
    M: Vec
    """Moment [N m]."""
    V: Vec
    """Velocity [m/s]."""


class Turning(NamedTuple):
    """Rotations in the cells."""

    omega: Vec
    """Rate of turning [rad/s]."""
    curvature: Vec
    """Curvature vector Omega [1/m]."""
    curvature_t: Vec
    """Rate dOmega/dt [1/(m s)]."""
    frame: Quaternion
    """Frame in the middle of the cell."""


class SpatialReference(eqx.Module):
    """Reference values in the cells, and dt [s]. A time derivative is (value - reference)/dt."""

    V: Vec
    omega: Vec
    strain: Array
    twist_slope: Array
    """Slope dOmega_tau/ds [1/m^2] of the twist, extrapolated from earlier stages."""
    dt: Array


class SpatialSection(eqx.Module):
    """The local state that an effect reads. The suffix `_s` is d/ds and `_t` is d/dt.

    V is relative to the tank, and u = V - U relative to the water. Rates of vectors are rates of
    the components. The last fields are those of `SpatialStructure`.
    """

    t: Array
    omega: Vec
    omega_t: Vec
    curvature: Vec
    curvature_t: Vec
    strain: Array
    V: Vec
    V_t: Vec
    u: Vec
    u_s: Vec
    u_t: Vec
    twist_slope: Array
    frame: Quaternion
    structure: SpatialStructure

    @property
    def height(self) -> Array:
        return self.structure.height

    @property
    def slip(self) -> Array:
        """Returns w = omega_tau - u_tau Omega_tau [rad/s], the roll relative to the water.

        A twisted section that slides through the water turns in it.
        """
        return self.omega.tau - self.u.tau * self.curvature.tau

    @property
    def slip_t(self) -> Array:
        turned = self.u_t.tau * self.curvature.tau + self.u.tau * self.curvature_t.tau
        return self.omega_t.tau - turned

    @property
    def slip_s(self) -> Array:
        omega_s = self.curvature_t.minus(self.curvature.cross(self.omega))
        return omega_s.tau - self.u_s.tau * self.curvature.tau - self.u.tau * self.twist_slope


class SpatialLoad(NamedTuple):
    """Load per length on a section."""

    force: Vec
    """F [N/m]."""
    couple: Vec
    """C [N]."""


def no_load(x: SpatialSection) -> SpatialLoad:
    """Returns a load of zero."""
    zero = jnp.zeros_like(x.strain)
    return SpatialLoad(Vec(zero, zero, zero), Vec(zero, zero, zero))


def strain_in_space(T: Array, x: SpatialStructure, reference: SpatialReference) -> Array:
    """Returns the strain eps [-] that solves T = EA (eps + alpha d(eps)/dt)."""
    lag = x.damping_time / reference.dt
    return (T / x.EA + lag * reference.strain) / (1.0 + lag)


def section_in_space(
    mid: SpatialFields,
    slope: SpatialFields,
    turning: Turning,
    structure: SpatialStructure,
    reference: SpatialReference,
    water: Float[Array, "2 3"] | None,
    t: Array,
) -> SpatialSection:
    """Returns the local state in each cell at time `t` [s].

    `water` contains velocity [m/s] and acceleration [m/s^2] of uniform water, each (x, y, z). It
    is None for still water.
    """
    dt, omega, curvature = reference.dt, turning.omega, turning.curvature
    V_t = mid.V.minus(reference.V).times(1.0 / dt)
    u, u_s, u_t = mid.V, slope.V, V_t
    if water is not None:
        U, A = (turning.frame.to_frame(vector) for vector in water)
        u, u_s, u_t = u.minus(U), u_s.plus(curvature.cross(U)), u_t.plus(omega.cross(U)).minus(A)
    return SpatialSection(
        t=t,
        omega=omega,
        omega_t=omega.minus(reference.omega).times(1.0 / dt),
        curvature=curvature,
        curvature_t=turning.curvature_t,
        strain=strain_in_space(mid.T.tau, structure, reference),
        V=mid.V,
        V_t=V_t,
        u=u,
        u_s=u_s,
        u_t=u_t,
        twist_slope=reference.twist_slope,
        frame=turning.frame,
        structure=structure,
    )


def equations_in_space(
    mid: SpatialFields,
    slope: SpatialFields,
    x: SpatialSection,
    reference: SpatialReference,
    active: Vec,
    load: SpatialLoad,
) -> tuple[Array, ...]:
    """Returns the twelve residuals of each cell, in the order of the module docstring.

    `active` is the moment M_act [N m] of the actuators.
    """
    s = x.structure
    stretch, omega, curvature = 1.0 + x.strain, x.omega, x.curvature
    strain_t = (x.strain - reference.strain) / reference.dt
    moved = slope.V.plus(curvature.cross(mid.V))
    bent = curvature.plus(x.curvature_t.times(s.damping_time))
    pull = slope.T.plus(curvature.cross(mid.T)).plus(load.force.times(stretch))
    push = x.V_t.plus(omega.cross(mid.V)).times(s.linear_density)
    J = s.inertia
    spin = Vec(J.tau * omega.tau, J.n * omega.n, J.b * omega.b)
    J_t = Vec(J.tau * x.omega_t.tau, J.n * x.omega_t.n, J.b * x.omega_t.b)
    turn = slope.M.plus(curvature.cross(mid.M)).plus(load.couple.times(stretch))
    return (
        strain_t - moved.tau,
        stretch * omega.b - moved.n,
        -stretch * omega.n - moved.b,
        *(m - k * c + a for m, k, c, a in zip(mid.M, s.stiffness, bent, active, strict=True)),
        *push.minus(pull),
        J_t.tau + (omega.n * spin.b - omega.b * spin.n) - turn.tau,
        J_t.n + (omega.b * spin.tau - omega.tau * spin.b) - turn.n + stretch * mid.T.b,
        J_t.b + (omega.tau * spin.n - omega.n * spin.tau) - turn.b - stretch * mid.T.n,
    )
