"""A swimming animal weighed by the robot's model: does its axial force balance, and what if not?

Midlines are prescribed, the model's own effects give the force, and the mean over whole strides is
held against the momentum gained. One mean force is one number, so several effects may close it;
what they need to do so is told, with the interval that one animal allows.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.lamprey.animal import (
    VISCOSITY,
    CrossSections,
    Prescribed,
    force,
    inertia,
    prescribe,
)
from calibration.lamprey.axial_balance import (
    CANDIDATES,
    DRAWS,
    EFFECTS,
    MOTIONS,
    Course,
    Draws,
    Ledger,
    alternative_motions,
    central_interval,
    ledger,
    sample_balance,
)
from calibration.lamprey.midlines import Midlines, read_midlines, read_width
from calibration.lamprey.motion import Motion, Smoothing, choose_smoothing, midline_motion
from calibration.lamprey.strides import AnimalGait, Strides, find_strides, fundamental, gait
from slider_jax import paper
from slider_jax.effects import ForceDensity, NormalDrag, ReactiveForce

WIDTH_COLUMN = "ammowidth"
FULL_OVER_GIVEN = 2.0
"""The widths are taken for half widths: as full ones the animal would weigh 1 g at 155 mm, where
sea lampreys of that length weigh about 5 g."""
POSSIBLE = 0.1
"""An effect can close the balance where at least so many of the draws need a value within its
prior range."""
SOURCES = ("strides", "reading", "shape", "coefficients")


@dataclass(frozen=True)
class Weighed:
    """The outcome. Forces [N] along the mean course."""

    midlines: Midlines
    smoothing: Smoothing
    motion: Motion
    shape: CrossSections
    held: Prescribed
    strides: Strides
    gait: AnimalGait
    C_d: float
    m_a: float
    ledger: Ledger
    by_source: dict[str, tuple[float, float]]
    """95 % intervals of the imbalance where one source alone varies."""
    draws: Draws
    """Where all of them vary."""
    floor: float
    """rms over strides and readings of what reading the midlines again changes."""
    smoothed: dict[str, tuple[Smoothing, float]]
    """Other smoothing, and the imbalance with it."""
    readings: list[Motion]

    @property
    def imbalance(self) -> np.ndarray:
        """(strides,), with the paper's coefficients."""
        return self.ledger.imbalance(self.C_d, self.m_a)

    @property
    def possible(self) -> dict[str, float]:
        """By effect: in which share of the draws the value it needs is within its prior range."""
        return {name: _within_prior(name, self.draws.closing(name)) for name in EFFECTS}

    @property
    def course(self) -> Course:
        return Course(self.strides, self.gait.direction)


def _within_prior(name: str, values: np.ndarray) -> float:
    (prior,) = EFFECTS[name].priors().values()
    return float(np.mean((values >= prior.low) & (values <= prior.high)))


def weigh(folder: Path, seed: int = 0, draws: int = DRAWS) -> Weighed:
    """Weigh the animal of a folder with lampreydata.csv and fishwidth.csv.

    `draws` from `seed` make the intervals. Raises `InputError` on data that cannot be used.
    """
    midlines = read_midlines(folder / "lampreydata.csv")
    places, given = read_width(folder / "fishwidth.csv", WIDTH_COLUMN)
    return weigh_midlines(midlines, CrossSections(places, FULL_OVER_GIVEN * given), seed, draws)


def weigh_midlines(
    midlines: Midlines, shape: CrossSections, seed: int = 0, draws: int = DRAWS
) -> Weighed:
    """Weigh an animal of `shape` that swims as `midlines` say; `draws` make the intervals."""
    rng = np.random.default_rng(seed)
    smoothing = choose_smoothing(midlines)
    moved = midline_motion(midlines, smoothing)
    strides = find_strides(moved)
    how = gait(moved, strides, VISCOSITY)
    course = Course(strides, how.direction)
    C_d, m_a = (float(x) for x in paper.force_coefficients(how.frequency))
    base = ledger(moved, shape, course)
    others = alternative_motions(midlines, smoothing, rng, min(MOTIONS, max(2, draws // 10)))
    pool = [moved, *others]

    def vary(*sources: str) -> Draws:
        return sample_balance(rng, pool, shape, course, (C_d, m_a), sources, draws)

    again = np.array([ledger(x, shape, course).imbalance(C_d, m_a) for x in others])
    smoothed = {}
    for name, other in _other_smoothing(smoothing).items():
        there = ledger(midline_motion(midlines, other), shape, course)
        smoothed[name] = (other, float(there.imbalance(C_d, m_a).mean()))
    return Weighed(
        midlines=midlines,
        smoothing=smoothing,
        motion=moved,
        shape=shape,
        held=prescribe(moved, shape),
        strides=strides,
        gait=how,
        C_d=C_d,
        m_a=m_a,
        ledger=base,
        by_source={source: central_interval(vary(source).imbalance) for source in SOURCES},
        draws=vary(*SOURCES),
        floor=float(np.sqrt(np.mean((again - base.imbalance(C_d, m_a)) ** 2))),
        smoothed=smoothed,
        readings=others,
    )


def _other_smoothing(x: Smoothing) -> dict[str, Smoothing]:
    return {
        "cutoff times 0.7": x._replace(cutoff=0.7 * x.cutoff),
        "cutoff times 1.4": x._replace(cutoff=1.4 * x.cutoff),
        "wavelength times 0.75": x._replace(wavelength=0.75 * x.wavelength),
        "wavelength times 1.5": x._replace(wavelength=1.5 * x.wavelength),
    }


def balance_verdict(x: Weighed) -> tuple[str, list[str]]:
    """The verdict, and the effects that can close the balance, likeliest first."""
    low, high = central_interval(x.draws.imbalance)
    if low <= 0.0 <= high:
        return "nothing_missing", []
    share = x.possible
    able = sorted((n for n in share if share[n] >= POSSIBLE), key=lambda n: -share[n])
    if not able:
        return "unexplained", []
    return ("identified" if len(able) == 1 else "class"), able


def errors(x: Weighed, closer: str) -> dict[str, float]:
    """rms [N] over strides of the imbalance: before, after, and what reading the midlines adds.

    After: each stride with the coefficient of `closer` from the other strides.
    """
    before, unit = x.imbalance, x.ledger.unit[closer]
    count = len(before)
    after = [
        before[i] - unit[i] * (before.sum() - before[i]) / (unit.sum() - unit[i])
        for i in range(count)
    ]
    return {"before": _rms(before), "after": _rms(np.array(after)), "floor": x.floor}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def small_amplitude_thrust(x: Weighed) -> float:
    """Lighthill's thrust [N] of a wave of small amplitude, from the tail's end alone.

        T = m_A ( (dh/dt)^2 - U^2 (dh/dx)^2 ) / 2,   mean over whole strides

    Source: Lighthill, M. J. (1960), Note on the swimming of slender fish, J. Fluid Mech. 9, 305.
    """
    depth = x.held.body.structure.height[0]
    m_A = float(ReactiveForce(x.m_a).added_mass(depth))
    side = np.array([-x.gait.direction[1], x.gait.direction[0]])
    h_t = x.motion.V[:, 0] @ side
    ahead = math.atan2(x.gait.direction[1], x.gait.direction[0])
    h_x = np.tan(x.motion.phi[:, 0] - ahead)
    rate = 0.5 * m_A * (h_t**2 - (x.gait.speed * h_x) ** 2)
    return float(x.strides.means(x.motion.t, rate).mean())


def skin(x: Weighed) -> dict[str, Any]:
    """The friction coefficient that closes the balance, on wetted area, beside flat plates'."""
    laid = x.held.body
    wetted = float(np.sum(laid.perimeter * laid.structure.ds))
    outline = float(np.sum(laid.structure.height * laid.structure.ds))
    C_t = x.draws.closing("tangential_friction")
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


def frontal_coefficient(x: Weighed) -> tuple[float, float, float]:
    """Drag coefficient on the largest section by which the head closes the balance, and 95 %."""
    laid = x.held.body
    section = float(np.max(math.pi / 4.0 * laid.width * laid.structure.height))
    area = x.draws.closing("head_drag") / section
    return float(np.median(area)), *central_interval(area)


def within_stride(x: Weighed) -> dict[str, float]:
    """What the course of a stride could say, and whether these midlines are precise enough.

    Axial quantities at twice the strides' frequency, where a symmetric swimmer's are: amplitude of
    the model's force and of the body's inertia [N], the centre of mass's motion [m] that either
    means, its spread over readings, and the largest motion by which two candidates differ that
    both close the mean.
    """
    t, course = x.motion.t, x.course

    def twice(series: np.ndarray) -> complex:
        double = Strides(x.strides.marks, 2.0 * x.strides.phase)
        return complex(fundamental(t, (series @ course.direction)[:, None], double)[0])

    per_force = 1.0 / (x.held.body.mass * (4.0 * math.pi * x.gait.frequency) ** 2)
    base = twice(_force(x, ReactiveForce(x.m_a))) + twice(_force(x, NormalDrag(x.C_d)))
    closing = {n: float(np.median(x.draws.closing(n))) for n in CANDIDATES}
    added = [closing[n] * twice(_force(x, EFFECTS[n])) for n in CANDIDATES]
    apart = max(abs(a - b) for a in added for b in added)
    seen = twice(np.asarray(inertia(x.held)))
    again = [twice(np.asarray(inertia(prescribe(m, x.shape)))) for m in x.readings]
    spread = math.sqrt(np.mean(np.abs(np.array(again) - seen) ** 2))
    return {
        "model_force_N": abs(base),
        "inertia_N": abs(seen),
        "model_motion_m": abs(base) * per_force,
        "measured_motion_m": abs(seen) * per_force,
        "motion_between_candidates_m": apart * per_force,
        "spread_of_motion_over_readings_m": spread * per_force,
        "misfit_of_midlines_m": misfit(x),
    }


def _force(x: Weighed, effect: ForceDensity) -> np.ndarray:
    return np.asarray(force(effect, x.held))


def misfit(x: Weighed) -> float:
    """rms distance [m] of measured points from the smoothed body, as far as it reaches."""
    L, count = x.motion.length, x.midlines.points.shape[1]
    squares = []
    for frame, length, r in zip(x.midlines.points, x.midlines.lengths, x.motion.r, strict=True):
        behind = np.linspace(0.0, length, count)
        body = np.stack([np.interp(L - behind, x.motion.s, r[:, i]) for i in (0, 1)], axis=1)
        squares.append(np.sum((frame - body)[behind <= L] ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(squares))))
