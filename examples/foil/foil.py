"""Compares a heaving and pitching foil with linear elongated-body theory, and draws a picture.

    python examples/foil/foil.py [PICTURE]

The theory is Lighthill's: a section of added mass m_A has the velocity w = D h relative to the
water, with D = d/dt - U d/dx and x forward, and the water exerts the force per length -D(m_A w).
h = y_h - phi_h d is the lateral displacement at the distance d from the leading edge. The forces on
the foil, which is pointed at the leading edge, are the integrals

    F_y = -d/dt int m_A w dd - U m_A w                   (m_A and w outside of integrals:
    F_x =  d/dt int m_A w phi_h dd                        at the trailing edge)
           + m_A (U phi_h w + w^2/2)

F_y is of first order in the motion, and F_x of second order. The last terms of F_x are the momentum
in the wake and the pressure at the trailing edge. The inertia of the foil is added to both forces.

Sources: Lighthill, M. J. (1960), Note on the swimming of slender fish, J. Fluid Mech. 9, 305-317;
Wu, T. Y. (1971), Hydromechanics of swimming propulsion, part 3, J. Fluid Mech. 46, 545-568.
"""

import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

FOLDER = Path(__file__).parent


class Motion(NamedTuple):
    """Motion of the leading edge: y_h = heave sin(w t), phi_h = pitch sin(w t + phase)."""

    frequency: float
    heave: float
    pitch: float
    phase: float
    speed: float


class Foil(NamedTuple):
    """A foil whose span grows linearly from the leading to the trailing edge."""

    length: float
    density: float
    """Mass per length [kg/m]."""
    spans: tuple[float, float]
    """Span [m] at the leading and at the trailing edge."""


def linear_forces(foil: Foil, motion: Motion, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns thrust and side force [N] on the sensor, whose axes pitch with the leading edge."""
    turn, L, m, U = 2.0 * math.pi * motion.frequency, foil.length, foil.density, motion.speed
    a, b = foil.spans[0], foil.spans[1] - foil.spans[0]
    section = math.pi * 1000.0 / 4.0
    head, m_A = (section * span**2 for span in foil.spans)
    # Integrals of the added mass, and of the added mass times the distance.
    M_0 = section * L * (a**2 + a * b + b**2 / 3.0)
    M_1 = section * L**2 * (a**2 / 2.0 + 2.0 * a * b / 3.0 + b**2 / 4.0)
    y, p = turn * t, turn * t + motion.phase
    y_t, y_tt = motion.heave * turn * np.cos(y), -motion.heave * turn**2 * np.sin(y)
    phi, phi_t = motion.pitch * np.sin(p), motion.pitch * turn * np.cos(p)
    phi_tt = -(turn**2) * phi
    w = y_t - phi_t * L - U * phi
    momentum = (y_t - U * phi) * M_0 - phi_t * M_1
    rate = (y_tt - U * phi_t) * M_0 - phi_tt * M_1
    # The library's model has no force at the leading edge, so the fluxes there are subtracted.
    w_head = y_t - U * phi
    F_y = -rate - U * (m_A * w - head * w_head) - m * (y_tt * L - phi_tt * L**2 / 2.0)
    wake = m_A * (U * phi * w + w**2 / 2.0) - head * (U * phi * w_head + w_head**2 / 2.0)
    F_x = rate * phi + momentum * phi_t + wake - m * L**2 / 2.0 * (phi_t**2 + phi * phi_tt)
    return F_x + phi * F_y, F_y


def foil_of(robot) -> Foil:
    """Returns the foil that a robot with one segment represents."""
    body = robot.body
    spans = float(body.height[0, 0]), float(body.height[-1, 1])
    return Foil(float(body.length), float(body.linear_density[0, 0]), spans)


def draw(t: np.ndarray, simulated, theory, path: Path) -> None:
    """Writes the picture of thrust and side force in one period."""
    from slider_jax.io.figures import new_figure, save_figure

    figure, axes = new_figure(2, 1, figsize=(7.0, 5.0), sharex=True)
    names = ("thrust [mN]", "side force [mN]")
    for axis, name, found, expected in zip(axes, names, simulated, theory, strict=True):
        axis.plot(t, 1e3 * found, label="slider_jax", linewidth=3.0, color="0.7")
        axis.plot(t, 1e3 * expected, "--", label="linear theory", color="C0")
        axis.axhline(1e3 * np.mean(found), color="C1", linewidth=0.8, label="mean of slider_jax")
        axis.set_ylabel(name)
    axes[0].legend(loc="upper right", fontsize="small")
    axes[1].set_xlabel("time [s]")
    figure.suptitle("Heaving and pitching foil, towed at 0.3 m/s")
    save_figure(figure, path)


def main(picture: Path) -> None:
    """Simulates the trial, prints the differences from the theory and draws the picture."""
    import slider_jax
    from slider_jax.experiment import load
    from slider_jax.simulation.trial import simulate_trial

    slider_jax.enable_float64()
    experiment = load.load(FOLDER / "experiment.toml")
    run = simulate_trial(experiment)
    trial, robot = run.trial, run.prepared.model.robot
    foil = foil_of(robot)
    motion = Motion(
        trial.clamp_frequency, trial.heave, trial.pitch, trial.pitch_phase, trial.tow_speed
    )
    period = 1.0 / motion.frequency
    last = (run.t > trial.duration - period) & (run.t <= trial.duration)
    t = run.t[last]
    simulated = [run.series[name][last] for name in ("thrust", "recoil")]
    theory = linear_forces(foil, motion, t)
    for name, found, expected in zip(("thrust", "side force"), simulated, theory, strict=True):
        off = np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2))
        print(
            f"{name}: mean {1e3 * found.mean():.3f} mN, theory {1e3 * expected.mean():.3f} mN; "
            f"rms difference {100 * off:.2f} % of the rms"
        )
    draw(t, simulated, theory, picture)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER / "foil.png")
