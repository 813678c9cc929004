"""Compares the modelled axial force on a swimming animal with the animal's change of momentum.

The effects of the robot's model compute the force for the measured motion. The imbalance is the
mean force over whole strides minus the change of momentum per time. The result is, for each effect,
the coefficient that makes the imbalance zero (closes the balance), with a 95 % interval.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.lamprey.animal import (
    VISCOSITY,
    CrossSections,
    PrescribedMotion,
    force_on_body,
    inertia,
    prescribe,
)
from calibration.lamprey.axial_balance import (
    CANDIDATES,
    EFFECTS,
    MOTIONS,
    SAMPLES,
    BalanceSamples,
    Course,
    StrideForces,
    alternative_motions,
    central_interval,
    forces_by_stride,
    sample_balances,
)
from calibration.lamprey.midlines import Midlines, read_midlines, read_width
from calibration.lamprey.motion import Motion, Smoothing, choose_smoothing, midline_motion
from calibration.lamprey.strides import AnimalGait, Strides, animal_gait, fundamental, whole_strides
from slider_jax import paper
from slider_jax.effects import ForceDensity, NormalDrag, ReactiveForce

WIDTH_COLUMN = "ammowidth"
WIDTH_OVER_HALF_WIDTH = 2.0
"""Full width divided by the width in the file, which is assumed to be half of the full width. With
full widths in the file, the mass would be 1 g, but a sea lamprey of 155 mm has about 5 g."""
MIN_POSSIBLE_SHARE = 0.1
"""An effect can close the balance if the required coefficient is within the prior range in at least
this fraction of the random samples."""
SOURCES = ("strides", "reading", "shape", "coefficients")


@dataclass(frozen=True)
class BalanceAnalysis:
    """The axial force balance of one animal. Forces [N] are along the mean course."""

    midlines: Midlines
    smoothing: Smoothing
    motion: Motion
    shape: CrossSections
    prescribed: PrescribedMotion
    strides: Strides
    gait: AnimalGait
    C_d: float
    m_a: float
    forces: StrideForces
    by_source: dict[str, tuple[float, float]]
    """95 % interval [N] of the imbalance if only one source of uncertainty varies."""
    samples: BalanceSamples
    """Samples in which all sources of uncertainty vary."""
    noise_floor: float
    """rms difference [N] between a stride's imbalance with `motion` and with `alternatives`."""
    other_smoothings: dict[str, tuple[Smoothing, float]]
    """Other smoothing settings, and the mean imbalance [N] with each setting."""
    alternatives: list[Motion]
    """Motions with another smoothing, another body length, and added tracing noise."""

    @property
    def imbalance(self) -> np.ndarray:
        """Imbalance (strides,) [N] with the paper's coefficients."""
        return self.forces.imbalance(self.C_d, self.m_a)

    @property
    def possible(self) -> dict[str, float]:
        """Fraction of samples in which an effect's required coefficient is in the prior range."""
        shares = {}
        for name, effect in EFFECTS.items():
            (prior,) = effect.priors().values()
            values = self.samples.closing(name)
            shares[name] = float(np.mean((values >= prior.low) & (values <= prior.high)))
        return shares


def analyse_folder(folder: Path, seed: int = 0, samples: int = SAMPLES) -> BalanceAnalysis:
    """Returns the balance of the animal in a folder with lampreydata.csv and fishwidth.csv.

    `samples` is the number of samples for the intervals. Raises `InputError` for unusable data.
    """
    midlines = read_midlines(folder / "lampreydata.csv")
    positions, half_width = read_width(folder / "fishwidth.csv", WIDTH_COLUMN)
    shape = CrossSections(positions, WIDTH_OVER_HALF_WIDTH * half_width)
    return analyse_midlines(midlines, shape, seed, samples)


def analyse_midlines(
    midlines: Midlines, shape: CrossSections, seed: int = 0, samples: int = SAMPLES
) -> BalanceAnalysis:
    """Returns the balance of an animal with the cross-sections `shape` and the given midlines."""
    rng = np.random.default_rng(seed)
    smoothing = choose_smoothing(midlines)
    motion = midline_motion(midlines, smoothing)
    strides = whole_strides(motion)
    gait = animal_gait(motion, strides, VISCOSITY)
    course = Course(strides, gait.direction)
    C_d, m_a = (float(x) for x in paper.force_coefficients(gait.frequency))
    forces = forces_by_stride(motion, shape, course)
    others = alternative_motions(midlines, smoothing, rng, min(MOTIONS, max(2, samples // 10)))
    motions = [motion, *others]

    def vary(*sources: str) -> BalanceSamples:
        return sample_balances(rng, motions, shape, course, (C_d, m_a), sources, samples)

    imbalances = np.array([forces_by_stride(x, shape, course).imbalance(C_d, m_a) for x in others])
    other_smoothings = {}
    for name, other in _other_smoothings(smoothing).items():
        other_forces = forces_by_stride(midline_motion(midlines, other), shape, course)
        other_smoothings[name] = (other, float(other_forces.imbalance(C_d, m_a).mean()))
    return BalanceAnalysis(
        midlines=midlines,
        smoothing=smoothing,
        motion=motion,
        shape=shape,
        prescribed=prescribe(motion, shape),
        strides=strides,
        gait=gait,
        C_d=C_d,
        m_a=m_a,
        forces=forces,
        by_source={source: central_interval(vary(source).imbalance) for source in SOURCES},
        samples=vary(*SOURCES),
        noise_floor=_rms(imbalances - forces.imbalance(C_d, m_a)),
        other_smoothings=other_smoothings,
        alternatives=others,
    )


def _other_smoothings(x: Smoothing) -> dict[str, Smoothing]:
    return {
        "cutoff times 0.7": x._replace(cutoff=0.7 * x.cutoff),
        "cutoff times 1.4": x._replace(cutoff=1.4 * x.cutoff),
        "wavelength times 0.75": x._replace(wavelength=0.75 * x.wavelength),
        "wavelength times 1.5": x._replace(wavelength=1.5 * x.wavelength),
    }


def balance_verdict(x: BalanceAnalysis) -> tuple[str, list[str]]:
    """Returns the verdict and the effects that can close the balance, the most probable first."""
    low, high = central_interval(x.samples.imbalance)
    if low <= 0.0 <= high:
        return "nothing_missing", []
    share = x.possible
    candidates = sorted(
        (n for n in share if share[n] >= MIN_POSSIBLE_SHARE), key=lambda n: -share[n]
    )
    if not candidates:
        return "unexplained", []
    return ("identified" if len(candidates) == 1 else "class"), candidates


def imbalance_errors(x: BalanceAnalysis, closer: str) -> dict[str, float]:
    """Returns the strides' rms imbalance [N] before and after adding `closer`, and the noise floor.

    `closer` is an effect. Its coefficient for each stride is computed from all other strides.
    """
    before, unit = x.imbalance, x.forces.unit[closer]
    after = before - unit * (before.sum() - before) / (unit.sum() - unit)
    return {"before": _rms(before), "after": _rms(after), "floor": x.noise_floor}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def small_amplitude_thrust(x: BalanceAnalysis) -> float:
    """Returns Lighthill's mean thrust [N] for waves of small amplitude.

        T = mean over whole strides of m_A ( (dh/dt)^2 - U^2 (dh/dx)^2 ) / 2 at the tail's end

    m_A is the added mass per length, h the lateral position, x the axial position, U the speed.
    Source: Lighthill, M. J. (1960), Note on the swimming of slender fish, J. Fluid Mech. 9, 305.
    """
    depth = x.prescribed.body.structure.height[0]
    m_A = float(ReactiveForce(x.m_a).added_mass(depth))
    side = np.array([-x.gait.direction[1], x.gait.direction[0]])
    h_t = x.motion.V[:, 0] @ side
    ahead = math.atan2(x.gait.direction[1], x.gait.direction[0])
    h_x = np.tan(x.motion.phi[:, 0] - ahead)
    rate = 0.5 * m_A * (h_t**2 - (x.gait.speed * h_x) ** 2)
    return float(x.strides.means(x.motion.t, rate).mean())


def skin_friction(x: BalanceAnalysis) -> dict[str, Any]:
    """Returns the skin-friction coefficient C_f that closes the balance, and C_f of flat plates."""
    body = x.prescribed.body
    wetted = float(np.sum(body.perimeter * body.structure.ds))
    outline = float(np.sum(body.structure.height * body.structure.ds))
    C_t = x.samples.closing("tangential_friction")
    Re = x.gait.reynolds
    laminar, turbulent = 1.328 / math.sqrt(Re), 0.074 / Re**0.2
    C_f = 2.0 * C_t * outline / wetted
    low, high = central_interval(C_f)
    return {
        "wetted_area_m2": wetted,
        "C_f": {"value": float(np.median(C_f)), "low": low, "high": high},
        "plate_laminar": laminar,
        "plate_turbulent": turbulent,
        "over_laminar": {
            "value": float(np.median(C_f) / laminar), "low": low / laminar, "high": high / laminar,
        },
    }  # fmt: skip


def frontal_coefficient(x: BalanceAnalysis) -> tuple[float, float, float]:
    """Returns the head's drag coefficient that closes the balance, and its 95 % interval."""
    body = x.prescribed.body
    section = float(np.max(math.pi / 4.0 * body.width * body.structure.height))
    area = x.samples.closing("head_drag") / section
    return float(np.median(area)), *central_interval(area)


def within_stride(x: BalanceAnalysis) -> dict[str, float]:
    """Returns axial amplitudes of the forces [N] and of the motion of the centre of mass [m].

    The amplitudes are at twice the stride frequency, the frequency of a symmetric swimmer's axial
    force. The spread is the rms difference [m] between measured and alternative motions.
    """
    double = Strides(x.strides.marks, 2.0 * x.strides.phase)

    def second_harmonic(series: np.ndarray) -> complex:
        axial = (series @ x.gait.direction)[:, None]
        return complex(fundamental(x.motion.t, axial, double)[0])

    def of_effect(effect: ForceDensity) -> complex:
        return second_harmonic(np.asarray(force_on_body(effect, x.prescribed)))

    per_force = 1.0 / (x.prescribed.body.mass * (4.0 * math.pi * x.gait.frequency) ** 2)
    base = of_effect(ReactiveForce(x.m_a)) + of_effect(NormalDrag(x.C_d))
    added = [float(np.median(x.samples.closing(n))) * of_effect(EFFECTS[n]) for n in CANDIDATES]
    difference = max(abs(a - b) for a in added for b in added)
    measured = second_harmonic(np.asarray(inertia(x.prescribed)))
    others = [second_harmonic(np.asarray(inertia(prescribe(m, x.shape)))) for m in x.alternatives]
    spread = math.sqrt(np.mean(np.abs(np.array(others) - measured) ** 2))
    return {
        "model_force_N": abs(base),
        "inertia_N": abs(measured),
        "model_motion_m": abs(base) * per_force,
        "measured_motion_m": abs(measured) * per_force,
        "motion_between_candidates_m": difference * per_force,
        "spread_of_motion_over_readings_m": spread * per_force,
        "misfit_of_midlines_m": midline_misfit(x),
    }


def midline_misfit(x: BalanceAnalysis) -> float:
    """Returns the rms distance [m] between the smoothed midline and the measured points."""
    L, count = x.motion.length, x.midlines.points.shape[1]
    squares = []
    for frame, length, r in zip(x.midlines.points, x.midlines.lengths, x.motion.r, strict=True):
        behind = np.linspace(0.0, length, count)
        body = np.stack([np.interp(L - behind, x.motion.s, r[:, i]) for i in (0, 1)], axis=1)
        squares.append(np.sum((frame - body)[behind <= L] ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(squares))))
