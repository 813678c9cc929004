"""The robot fish as a model of the simulator: rigid head, five flexible hinges, fin, and tendons.

Positions x [m] run from nose to tail, with zero at the middle of the head plate, as in the folder
of the data. Hinge i bends the strip between two plates; its stiffness is EI = k (length of strip).
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from slider_jax.actuation import Ideal, Tendon
from slider_jax.actuation.prescribed_shape import PrescribedShape
from slider_jax.actuation.waveform import Segment, Waveform
from slider_jax.beam.parameters import Numerics, Robot, Scalar
from slider_jax.beam.parts import RobotPart
from slider_jax.dynamics.model import Drive, Model, make_mesh
from slider_jax.effects.base import ForceDensity
from slider_jax.effects.water.head_drag import HeadDrag
from slider_jax.effects.water.keulegan_carpenter_drag import KeuleganCarpenterDrag
from slider_jax.errors import InputError
from slider_jax.io.csv import read_table
from slider_jax.supports import Free

NOSE, END, JOINT = -0.077, 0.4823, 0.41
"""x [m] of the nose and of the tail's end, and of the node between the beam's body and tail."""
STRIPS = np.array([[0.278, 0.292], [0.307, 0.322], [0.337, 0.354], [0.369, 0.383], [0.398, 0.404]])
"""x [m] of the ends of the flexible strips, whose middles are the hinges."""
HINGES = STRIPS.mean(axis=1)
MARKER_X = np.array([-0.077, 0.065, 0.28, 0.2995, 0.3295, 0.3615, 0.3905, 0.4115, 0.474])
"""x [m] of the markers."""
STATED_HINGE = 0.65
"""Stiffness [N m/rad] of a hinge that the data's source states."""
RIGID_EI, EA = 100.0, 1e6
"""EI [N m^2] of the plates, and EA [N] everywhere."""
DAMPING_TIME = 5e-3
"""Damping time alpha [s] of the hinges, which the data's source sets to zero."""
DENSITY = 1000.0
"""Density [kg/m^3] of the water."""
ROUTE_X = np.array([0.1655, 0.304, 0.334, 0.366, 0.395, 0.416])
ROUTE_Y = np.array([0.055, 0.045, 0.035, 0.025, -0.015, -0.005])
"""x [m], and distance [m] from the axis, of the points of a tendon."""
CRANK, CRANK_X, CRANK_Y = 0.0345, 0.304 - 0.1655, 0.055 - 0.045
"""Radius [m] of the motor's crank, and offsets [m] from its axis to the tendon's first point."""


class Parameters(eqx.Module):
    """The free parameters; a fit changes them, and all other numbers are from the data's folder."""

    C: Scalar
    """Drag coefficient of the crossflow at the Keulegan-Carpenter number 1 [-]."""
    yaw_inertia: Scalar
    """Moment of inertia [kg m^2] about z that the head has in addition to the stated masses."""
    sway_mass: Scalar
    """Mass M [kg] of the head and its water in lateral motion, at a beat of 1 Hz."""
    sway_exponent: Scalar
    """Exponent p of the beat in the head's sway mass [-]. It is empirical."""
    pull: Scalar
    """Length that the motor pulls in, divided by the length from its dimensions [-]."""
    hinge: Scalar
    """Bending stiffness [N m/rad] of a hinge. It acts only if tendons move the tail."""


ADDED_MASS = 0.3
"""Added-mass coefficient of the tail.

A panel method for a plate of the fish's outline gives 0.20 to 0.30, because the water also flows
around the rear edge of the short fin.
"""
DRAG_AREA = 0.017
"""Drag coefficient times frontal area [m^2], estimated from the robot's dimensions."""
TENDON_STIFFNESS = 2e4
"""Stiffness [N/m] of a tendon, from the data's source."""


class WakelessInertia(ForceDensity):
    """Inertia of the water around a body that leaves no momentum in a wake.

        f = -d(m_A u_n n)/dt:    F_n = -m_A du_n/dt,    F_tau = m_A u_n omega
        m_A = c pi rho H^2/4

    The coefficient c is `head` for s > `hinge`, and `tail` elsewhere. `ReactiveForce` contains in
    addition the momentum that the tail leaves in the wake. That momentum requires a wake that is
    long against the fin; this fish advances by 0.11 m per beat, and its fin beats over 0.11 m.
    """

    head: Scalar
    tail: Scalar
    hinge: float
    density: Scalar

    def force(self, x):
        c = jnp.where(x.s > self.hinge, self.head, self.tail)
        m_A = c * math.pi * self.density * x.height**2 / 4.0
        return m_A * x.u_n * x.omega, -m_A * x.u_n_t


@dataclass(frozen=True)
class Dimensions:
    """Masses and outlines of the fish, from `parts.csv` and the outlines of the fins."""

    mass: Float[np.ndarray, " 6"]
    """Masses [kg] of the head and of the five tail segments."""
    centre: Float[np.ndarray, " 6"]
    """x [m] of their centres of mass."""
    inertia: Float[np.ndarray, " 6"]
    """Moments of inertia [kg m^2] about z through their centres of mass."""
    fin_x: Float[np.ndarray, " points"]
    fin_height: Float[np.ndarray, " points"]
    """x [m] of the tail fin's outline and its height [m] from tip to tip."""
    top_x: Float[np.ndarray, " points"]
    top_z: Float[np.ndarray, " points"]
    """x [m] and z [m] of the upper edge of the top fin."""


def read_dimensions(folder: Path) -> Dimensions:
    """Returns the dimensions in a folder of the data. Raises `InputError`."""
    columns = "x_front_m x_rear_m y_min_m y_max_m mass_kg".split()
    path = folder / "parts.csv"
    table = read_table(path, columns)
    names = [line.split(",")[1] for line in path.read_text().splitlines()[1:] if line.strip()]
    order = {"head": 0, "motor": 0, **{f"tail{k}": k + 1 for k in range(5)}}
    unknown = [name for name in names if name not in order]
    if unknown:
        raise InputError(f"{path}: body {unknown[0]}; allowed {', '.join(order)}")
    at = np.array([order[name] for name in names])
    front, rear, left, right, mass = (table[name] for name in columns)
    middle = 0.5 * (front + rear)
    own = ((rear - front) ** 2 + (right - left) ** 2) / 12.0 + middle**2
    total, first, second = (
        np.bincount(at, weights=w, minlength=6) for w in (mass, mass * middle, mass * own)
    )
    fin = read_table(folder / "fin_tail.csv", ("x_m", "z_outer_m"))
    centre = first / total
    top = read_table(folder / "fin_top.csv", ("x_m", "z_high_m"))
    return Dimensions(
        total, centre, second - total * centre**2,
        fin["x_m"], 2.0 * fin["z_outer_m"], top["x_m"], top["z_high_m"],
    )  # fmt: skip


def height_at(x: np.ndarray, size: Dimensions) -> np.ndarray:
    """Returns the height H [m] at `x` [m]. Water leaves the fin at its largest height.

    The top fin adds to the height of the body. The gaps between plates are short against the
    height, so H is interpolated across them.
    """
    plates_x = [NOSE, 0.123, 0.1231, 0.278, 0.2995, 0.3295, 0.3615, 0.3905, 0.4115]
    plates = [0.1, 0.1, 0.105, 0.105, 0.1, 0.095, 0.09, 0.085, 0.08]
    fin = np.interp(x, size.fin_x, np.maximum.accumulate(size.fin_height))
    plate = np.interp(x, plates_x, plates)
    top = np.interp(x, size.top_x, size.top_z, left=0.0, right=0.0)
    return np.maximum(plate + np.maximum(top - 0.5 * plate, 0.0), fin)


def robot_of_fish(
    size: Dimensions, yaw_inertia: Scalar = 0.0, hinge: Scalar = STATED_HINGE
) -> Robot:
    """Returns the fish as a robot. `yaw_inertia` [kg m^2] is added to the rigid head.

    `hinge` [N m/rad] is the stiffness of a hinge.

    Only mass, centre and moment of inertia of the rigid head have an influence on its motion. The
    density along the head is therefore the parabola with these three values.
    """
    strips = STRIPS.ravel()
    head = np.linspace(NOSE, HINGES[0], 25)
    fin = np.linspace(JOINT, END, 19)
    body_x = np.unique(np.concatenate([head, strips, HINGES, [JOINT, 0.123]]))
    body, tail = (_part(x, size, yaw_inertia, hinge) for x in (body_x, fin))
    return Robot(body, tail, chambers=(), K_Q=0.0)


def _part(x: np.ndarray, size: Dimensions, yaw_inertia: Scalar, hinge: Scalar) -> RobotPart:
    middle = 0.5 * (x[1:] + x[:-1])
    ends = np.stack([x[:-1], x[1:]], axis=1)
    soft = np.any([(a < middle) & (middle < b) for a, b in STRIPS], axis=0)
    strip = np.clip(np.searchsorted(STRIPS[:, 1], middle), 0, 4)
    EI = jnp.where(soft, hinge * np.diff(STRIPS, axis=1)[strip, 0], RIGID_EI)
    both = np.ones((len(middle), 2))
    segment = np.searchsorted(HINGES, middle)
    borders = np.concatenate([[NOSE], HINGES, [END]])
    uniform = (size.mass / np.diff(borders))[segment]
    density = jnp.asarray(uniform[:, None] * both)
    if segment[0] == 0:
        head = _parabola(ends, size, yaw_inertia)
        density = jnp.where((segment == 0)[:, None], head, density)
    return RobotPart(
        lengths=jnp.asarray(np.diff(x)),
        linear_density=density,
        EI=EI[:, None] * both,
        EA=EA,
        damping_time=DAMPING_TIME,
        height=jnp.asarray(height_at(ends, size)),
    )


def _parabola(x: np.ndarray, size: Dimensions, yaw_inertia: Scalar) -> Array:
    """Returns the density [kg/m] at `x` of a head with the given mass, centre and inertia."""
    # The density is linear between the points of the head, so its moments are those of the pieces.
    near, far = x[x[:, 1] < HINGES[0] + 1e-9].T
    middle = 0.5 * (near + far)
    moments = np.array(
        [
            [
                np.sum(
                    (far - near)
                    / 6.0
                    * (near ** (i + j) + 2.0 * middle**i * (near**j + far**j) + far ** (i + j))
                )
                for j in range(3)
            ]
            for i in range(3)
        ]
    )
    second = size.inertia[0] + yaw_inertia + size.mass[0] * size.centre[0] ** 2
    needed = jnp.stack([jnp.asarray(size.mass[0]), size.mass[0] * size.centre[0], second])
    c = jnp.asarray(np.linalg.inv(moments)) @ needed
    return c[0] + c[1] * x + c[2] * x**2


class HingeShape(PrescribedShape):
    """Prescribed hinge angles, theta_i(t) = Re(sum over n of A_ni exp(2 pi i n f t)).

    A positive angle bends the tail to the left. `strips` (hinges, cells) [1/m] is the curvature of
    the cells per hinge angle; its integral along the body is one for each hinge.
    """

    frequency: Scalar
    """f [Hz]."""
    cosine: Float[Array, "harmonics hinges"]
    sine: Float[Array, "harmonics hinges"]
    """Real part and minus the imaginary part of A [rad]."""
    strips: Float[Array, "hinges cells"]

    def angles(self, t: Array) -> Float[Array, " hinges"]:
        """Returns the hinge angles [rad] at `t` [s]."""
        n = jnp.arange(1.0, self.cosine.shape[0] + 1.0)
        turn = 2.0 * jnp.pi * self.frequency * n * t
        return jnp.cos(turn) @ self.cosine + jnp.sin(turn) @ self.sine

    def curvature(self, distance, t):
        return self.angles(t) @ self.strips


class RigidSpan(PrescribedShape):
    """A span that stays straight.

    The parabolic density of the head may be negative at some places. Only a head that cannot bend
    at all is then stable.
    """

    def curvature(self, distance, t):
        return 0.0 * distance


class CrankPull(Waveform):
    """Length [m] by which a steadily turning crank pulls a tendon, relative to crank angle zero.

    pull = gain (m(a) - m(0)),    a = 2 pi (f t - phase)
    m(a)^2 = (X + R sin a)^2 + Y^2 + (R cos a)^2

    R is the radius of the crank, and X and Y are the offsets of the tendon's first point.
    """

    frequency: Scalar
    phase: Scalar = 0.0
    gain: Scalar = 1.0

    def at(self, t):
        def m(a):
            x, z = CRANK_X + CRANK * jnp.sin(a), CRANK * jnp.cos(a)
            return jnp.sqrt(x**2 + CRANK_Y**2 + z**2)

        # The motor starts smoothly in the first beat, because the simulated tail starts straight.
        start = 0.5 - 0.5 * jnp.cos(jnp.pi * jnp.clip(self.frequency * t, 0.0, 1.0))
        turn = 2.0 * jnp.pi * (self.frequency * t - self.phase)
        return start * self.gain * (m(turn) - m(0.0))

    def segment(self, t0, t1):
        middle = 0.5 * (t0 + t1)
        half = self.at(middle)
        return Segment(t0, middle, t1, self.at(t0), half, half, self.at(t1))


class RoutedTendon(Tendon):
    """An elastic tendon through guides; between guides, its offset e is linear.

        P = stiffness (pull + elongation)

    As in the data's source, the tendon pulls and pushes.
    """

    route: Float[Array, " guides"]
    """Distances [m] of the guides from the head."""
    offsets: Float[Array, " guides"]
    """Offset e [m] at the guides."""
    pull: Waveform
    stiffness: Scalar

    elastic: ClassVar[bool] = True

    def offset_at(self, distance):
        return jnp.interp(distance, self.route, self.offsets)

    def tension(self, elongation, t):
        return self.stiffness * (self.pull.at(t) + elongation)


def strip_weights(robot: Robot, numerics: Numerics) -> Float[Array, "hinges cells"]:
    """Returns the curvature [1/m] of each cell per unit angle of each hinge.

    The curvature of a hinge is uniform along its strip. kappa = d(phi)/ds with s towards the head,
    so a tail that bends to the left has a positive curvature.
    """
    structure = make_mesh(robot, numerics).structure
    s, ds = np.asarray(structure.s), np.asarray(structure.ds)
    behind = END - STRIPS[:, ::-1]
    begin = np.maximum(s - 0.5 * ds, behind[:, :1])
    end = np.minimum(s + 0.5 * ds, behind[:, 1:])
    share = np.maximum(end - begin, 0.0) / np.diff(behind, axis=1)
    return jnp.asarray(share / ds)


def head_coefficient(size: Dimensions, x: Parameters, beat: Scalar) -> Scalar:
    """Returns the added-mass coefficient with which the head's sway mass is M (f/1 Hz)^p.

    `beat` is f [Hz]. The coefficient is negative at slow beats.
    """
    edges = np.linspace(NOSE, HINGES[0], 400)
    middle = 0.5 * (edges[1:] + edges[:-1])
    unit = DENSITY * math.pi / 4.0 * float(np.sum(height_at(middle, size) ** 2 * np.diff(edges)))
    return (x.sway_mass * beat**x.sway_exponent - size.mass[0]) / unit


def model_of_fish(size: Dimensions, x: Parameters, beat: Scalar, actuators: tuple) -> Model:
    """Returns the swimming fish with the water's forces and the given actuators."""
    head = head_coefficient(size, x, beat)
    effects = (
        WakelessInertia(head, ADDED_MASS, END - HINGES[0], DENSITY),
        KeuleganCarpenterDrag(x.C, stride_frequency=beat, density=DENSITY),
        HeadDrag(DRAG_AREA, DENSITY),
    )
    robot = robot_of_fish(size, x.yaw_inertia, x.hinge)
    return Model(robot, effects, Ideal(), Drive(()), Free(), actuators=actuators)


def hinge_drive(
    A: Complex[np.ndarray, "harmonics hinges"], beat: float, robot: Robot, numerics: Numerics
) -> tuple[HingeShape]:
    """Returns the actuator that prescribes the hinge angles with the harmonics `A` [rad]."""
    return (
        HingeShape(
            0.0, END - NOSE, jnp.asarray(beat), jnp.asarray(A.real), jnp.asarray(-A.imag),
            strip_weights(robot, numerics),
        ),
    )  # fmt: skip


def tendon_drive(beat: Scalar, x: Parameters) -> tuple[RigidSpan, RoutedTendon, RoutedTendon]:
    """Returns the rigid head and the two tendons, whose motor turns once per beat."""

    def tendon(side, phase):
        return RoutedTendon(
            near=STRIPS[0, 0] - NOSE,
            far=ROUTE_X[-1] - NOSE,
            offset=0.0,
            route=jnp.asarray(ROUTE_X - NOSE),
            offsets=jnp.asarray(side * ROUTE_Y),
            pull=CrankPull(beat, phase, x.pull),
            stiffness=TENDON_STIFFNESS,
        )

    head = RigidSpan(0.0, STRIPS[0, 0] - NOSE)
    return head, tendon(1.0, 0.0), tendon(-1.0, 0.5)
