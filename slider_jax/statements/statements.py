"""The paper's quantitative statements, each with its place, its tolerance and how it is checked.

Tolerances were set before any search for assumptions (`TOLERANCES`). Source of all statements: Van
Stratum et al., Model-based Optimization of Anguilliform Swimming Gaits for Soft Robotic
Applications.
"""

from typing import NamedTuple

import numpy as np

from slider_jax import paper

REPRODUCED = "reproduced"
ASSUMED = "reproduced under assumptions"
MISSED = "not reproduced by any simulated set"
FAILED = "simulation failed"
CONSISTENT = "consistent with the paper's other numbers"
INCONSISTENT = "contradicted by the paper itself"
UNDECIDABLE = "not decidable"
INPUT = "input"
OMITTED = "not simulated"
VERDICTS = (
    REPRODUCED, ASSUMED, MISSED, FAILED, CONSISTENT, INCONSISTENT, UNDECIDABLE, INPUT, OMITTED
)  # fmt: skip

TOLERANCES = {
    "result of the paper's model, or measured value": "10 %",
    "value stated with 'about' or 'approximately'": "25 %, or 0.1 for a fraction of a stride",
    "frequency of the sweep": "0.2 Hz, one step of the sweep",
    "speed": "5 %",
    "static tip": "5 %",
    "quantity that follows from two others": "15 %",
    "influence of m_a on the amplitude": "a quarter of that of C_d",
    "steady after three cycles": "3 mN, 5 % of the peak thrust",
    "phase of 0.5": "half of the speed at 0.2",
    "comparison without a number": "the sign",
    "best phase": "0.05 of a period",
    "optimum": "no simulated neighbour of the optimum is faster by more than 1 % of its speed",
    "influence of the weight of swimming": "a change by 10 %",
    "rapid shift": "half of the whole change in a quarter of the range of the weight",
    "arithmetic with the paper's own numbers": "one unit of the last printed digit",
}


class Simulated(NamedTuple):
    """A statement that a simulation checks: `fact` has to be from `low` to `high`."""

    place: str
    text: str
    fact: str
    """Name of a number from `facts`."""
    low: float
    high: float
    unit: str = "-"
    factor: float = 1.0
    """Factor from SI units to `unit`."""
    reading: str = ""
    """How the statement is read where the paper does not define a quantity."""
    counted: bool = True
    """Whether the search for assumptions counts the statement."""

    @property
    def published(self) -> float | None:
        """Middle of the allowed interval in SI units; None for a one-sided interval."""
        both = np.isfinite(self.low) and np.isfinite(self.high)
        return 0.5 * (self.low + self.high) if both else None

    def agrees(self, value: float) -> bool:
        """Returns whether a simulated value is within the tolerance."""
        allowed = 1e-9 * np.nan_to_num([self.low, self.high], posinf=0.0, neginf=0.0)
        return bool(self.low - abs(allowed[0]) <= value <= self.high + abs(allowed[1]))

    def miss(self, value: float) -> float:
        """Returns the distance from the published value in tolerances; at most 1 if it agrees.

        For a one-sided interval, the miss is 0 inside, and 1 just outside; it grows by 1 for each
        10 % of the bound, or 0.01 SI units. A value that is not available misses by 100.
        """
        if not np.isfinite(value):
            return 100.0
        if self.published is not None:
            return abs(value - self.published) / (0.5 * (self.high - self.low))
        bound = self.low if np.isfinite(self.low) else self.high
        outside = max(self.low - value, value - self.high, 0.0)
        return outside / max(0.1 * abs(bound), 0.01) + (outside > 0.0)


def _within(value: float, share: float) -> tuple[float, float]:
    return value * (1.0 - share), value * (1.0 + share)


def _near(value: float, tolerance: float) -> tuple[float, float]:
    return value - tolerance, value + tolerance


def uniform_tip(body: float, tail: float, curvature: float) -> float:
    """Returns the lateral displacement [m] of the tip of a body that bends to an arc.

    `body` and `tail` are lengths [m], and `curvature` [1/m] is that of the body. The tail is
    straight.
    """
    angle = curvature * body
    return float((1.0 - np.cos(angle)) / curvature + tail * np.sin(angle))


TABLE_1, STATIC = "Table 1", "Parameter identification"
SWEEP, ONE_HZ, FIG_6 = "Fig. 4", "Fig. 5", "Fig. 6"
MAP_A, MAP_B, MAP_C, MAP_D = "Fig. 7a", "Fig. 7b", "Fig. 7c", "Fig. 7d"
MULTIMODAL = "Multimodal co-optimisation"
GA, PERFORMANCE = "Optimum of the genetic algorithm", "Table of the optimum"
inf = float("inf")
FASTER = 0.0023
"""Gain of speed [m/s], 1 % of 23.2 cm/s, up to which a neighbour of the optimum is not faster."""

SIMULATED: dict[str, Simulated] = {
    "static_tip": Simulated(
        STATIC, "45 kPa in chambers 1 and 2 displace the tip by 102 mm.",
        "static_tip_m", *_within(0.102, 0.05), "mm", 1e3,
        "chambers 1 and 2 are the front and the rear chamber of one side",
    ),
    "sweep_minimum_frequency": Simulated(
        SWEEP, "The mean thrust has its minimum at approximately 1 Hz.",
        "sweep_minimum_Hz", *_near(paper.MINIMUM_NEAR, paper.NEAR_HZ), "Hz",
    ),
    "sweep_minimum_negative": Simulated(
        ONE_HZ, "At 1 Hz the robot would swim backwards: the mean thrust is negative.",
        "thrust_1_Hz_N", -inf, 0.0, "mN", 1e3,
    ),
    "sweep_peak_frequency": Simulated(
        SWEEP, "The mean thrust peaks at 4.8 Hz.", "sweep_peak_Hz",
        *_near(paper.PEAK_AT, paper.NEAR_HZ), "Hz",
    ),
    "sweep_peak": Simulated(
        SWEEP, "The largest mean thrust is near 60 mN.",
        "sweep_peak_N", *_within(paper.PEAK_THRUST, paper.NEAR), "mN", 1e3,
    ),
    "roll_off": Simulated(
        SWEEP, "Beyond the peak, the thrust rolls off at about 20 mN/Hz.",
        "roll_off_N_per_Hz", *_within(paper.ROLL_OFF, paper.ABOUT), "mN/Hz", 1e3,
        "from the peak to 7 Hz",
    ),
    "recoil_1_Hz": Simulated(
        ONE_HZ, "At 1 Hz, the recoil exceeds 1000 mN for 60 % of the cycle (measured).",
        "recoil_share_1_Hz", *_near(paper.RECOIL_SHARES[1.0], paper.NEAR_SHARE), "%", 100.0,
    ),
    "recoil_4p8_Hz": Simulated(
        FIG_6, "At 4.8 Hz, the recoil exceeds 1000 mN for about 40 % of the cycle (measured).",
        "recoil_share_4p8_Hz", *_near(paper.RECOIL_SHARES[4.8], paper.NEAR_SHARE), "%", 100.0,
    ),
    "thrust_rises": Simulated(
        SWEEP, "From the minimum to the peak, the thrust increases with the frequency.",
        "least_rise_N", 0.0, inf, "mN", 1e3, "smallest increase between two simulated frequencies",
    ),
    "pressure_falls": Simulated(
        FIG_6, "At 4.8 Hz, the pressure is lower than at 1 Hz.", "pressure_ratio", -inf, 1.0,
        reading="ratio of the largest pressures",
    ),
    "tip_falls": Simulated(
        FIG_6, "At 4.8 Hz, the tip moves less than at 1 Hz.", "tip_ratio", -inf, 1.0,
        reading="ratio of the tip's excursions",
    ),
    "inertia_gives_thrust": Simulated(
        FIG_6, "Inertial forces are crucial for generating net thrust.",
        "thrust_without_m_a_N", -inf, 0.0, "mN", 1e3, "thrust at 4.8 Hz without added mass",
    ),
    "thrust_4p8_Hz": Simulated(
        FIG_6, "At 4.8 Hz, the net thrust is positive.", "thrust_4p8_Hz_N", 0.0, inf, "mN", 1e3,
    ),
    "settled": Simulated(
        "Tank tests", "The thrust is steady after 3 tailbeat cycles.",
        "settling_N", -inf, 0.003, "mN", 1e3,
        "largest change from the fourth to the fifth stride; allowed: 5 % of 60 mN",
    ),
    "C_d_lowers_tip": Simulated(
        STATIC, "The amplitude of the tail decreases with C_d.",
        "tip_by_C_d", -inf, 0.0, "%", 100.0, "C_d larger by 20 %, head fixed, 4.8 Hz",
    ),
    "m_a_hardly_changes_tip": Simulated(
        STATIC, "The amplitude of the tail is minimally affected by m_a.",
        "tip_by_m_a_over_C_d", -inf, 0.25, "-", 1.0,
        "change with m_a smaller by 20 %, divided by the change with C_d larger by 20 %",
    ),
    "m_a_raises_thrust": Simulated(
        STATIC, "The thrust increases monotonically with m_a.",
        "thrust_by_m_a_N", 0.0, inf, "mN", 1e3,
        "smaller of the increases from m_a = 0 to 0.8 and from 0.8 to 1, at 4.8 Hz",
    ),
    "speed": Simulated(
        PERFORMANCE, "The optimal design swims at 23.2 cm/s (model).",
        "speed_m_per_s", *_within(0.232, 0.05), "cm/s", 100.0,
    ),
    "speed_70_mm": Simulated(
        GA, "With a tail of 70 mm, the robot swims at 21.7 cm/s (measured; in the table 22 cm/s).",
        "speed_70_mm_m_per_s", *_within(0.217, 0.05), "cm/s", 100.0,
    ),
    "tail_amplitude_measured": Simulated(
        PERFORMANCE, "The tail's lateral excursion A_t is 3.9 cm (experiment).",
        "tail_amplitude_70_mm_m", *_within(0.039, paper.NEAR), "cm", 100.0,
        "tail of 70 mm; not counted", False,
    ),
    "wavelength_measured": Simulated(
        PERFORMANCE, "The wavelength of the body is 26.5 cm (experiment).",
        "shape_wavelength_70_mm_m", *_within(0.265, paper.NEAR), "cm", 100.0,
        "tail of 70 mm, wavelength of the shape; not counted", False,
    ),
    "tail_amplitude": Simulated(
        PERFORMANCE, "The tail's lateral excursion A_t is 3.6 cm (model).",
        "tail_amplitude_m", *_within(0.036, paper.NEAR), "cm", 100.0,
        "half of the peak-to-peak excursion, which the Strouhal number 2 A_t f/U requires",
    ),
    "wavelength": Simulated(
        PERFORMANCE, "The wavelength of the body is 28 cm (model).",
        "shape_wavelength_m", *_within(0.28, paper.NEAR), "cm", 100.0, "wavelength of the shape",
    ),
    "wave_speed": Simulated(
        PERFORMANCE, "The speed of the travelling wave is 177 cm/s (model).",
        "wave_speed_m_per_s", *_within(1.77, paper.NEAR), "cm/s", 100.0,
        "wavelength of the shape times f; not counted, since it follows from lambda", False,
    ),
    "speed_over_wave_speed": Simulated(
        PERFORMANCE, "The Froude efficiency (U + V)/2V is 0.57, so U/V is 0.13 (model).",
        "speed_over_wave_speed", *_within(0.232 / 1.77, 0.15),
        reading="U/V, with V from the wavelength of the shape; not counted", counted=False,
    ),
    "strouhal": Simulated(
        PERFORMANCE, "The Strouhal number 2 A_t f/U is 1.96 (model).",
        "strouhal", *_within(1.96, 0.15), reading="not counted", counted=False,
    ),
    "strouhal_70_mm": Simulated(
        PERFORMANCE, "The Strouhal number is 2.12 (experiment).", "strouhal_70_mm",
        *_within(2.12, 0.15), reading="tail of 70 mm; not counted", counted=False,
    ),
    "tail_slope": Simulated(
        PERFORMANCE, "The tail slope A_t/(lambda/4) is 0.51, from the model's A_t and lambda.",
        "shape_tail_slope", *_within(0.51, 0.15),
        reading="the printed 0.57 does not follow from them; not counted", counted=False,
    ),
    "tail_slope_70_mm": Simulated(
        PERFORMANCE, "The tail slope is 0.59 (experiment).", "shape_tail_slope_70_mm",
        *_within(0.59, 0.15), reading="tail of 70 mm; not counted", counted=False,
    ),
    "length_over_wavelength": Simulated(
        "Fig. 8", "The ratio of length to wavelength is 1.4 (experiment).",
        "length_over_wavelength_70_mm", *_within(1.4, paper.NEAR),
        reading="tail of 70 mm, wavelength of the shape; not counted", counted=False,
    ),
    "optimal_frequency": Simulated(
        GA, "The optimal frequency is 6.3 Hz.", "gain_by_frequency_m_per_s", -inf, FASTER, "cm/s",
        100.0, "gain of speed at 5.6 or 7.0 Hz",
    ),
    "optimal_phase": Simulated(
        GA, "The optimal phase is 0.14.", "gain_by_phase_m_per_s", -inf, FASTER, "cm/s", 100.0,
        "gain of speed at a phase of 0.07 or 0.21",
    ),
    "optimal_rear_pressure": Simulated(
        GA, "The optimal rear pressure is 414 kPa, below the front's 448 kPa.",
        "gain_by_rear_m_per_s", -inf, FASTER, "cm/s", 100.0, "gain of speed at 448 kPa",
    ),
    "optimal_length": Simulated(
        GA, "The optimal tail is 53 mm long.", "gain_by_tail_length_m_per_s", -inf, FASTER, "cm/s",
        100.0, "gain of speed with a tail of 43 or 70 mm",
    ),
    "optimal_stiffness": Simulated(
        GA, "The optimal tail has 17 mN m^2, the largest allowed stiffness.",
        "gain_by_EI_tail_m_per_s", -inf, FASTER, "cm/s", 100.0, "gain of speed with 12.5 mN m^2",
    ),
    "best_phase": Simulated(
        MAP_B, "The speed increases up to a phase of approximately 15 % of the period.",
        "best_phase", *_near(0.15, 0.05), "%", 100.0, "tail of 60 mm",
    ),
    "best_phase_speed": Simulated(
        MAP_D, "The peak speed over the phase is 21.3 cm/s (measured; the model agrees).",
        "best_phase_speed_m_per_s", *_within(0.213, 0.05), "cm/s", 100.0,
    ),
    "negative_phase": Simulated(
        MAP_B, "With a negative phase, the robot is slower than with a phase of 0.",
        "loss_by_negative_phase_m_per_s", 0.0, inf, "cm/s", 100.0,
        "loss of speed from a phase of 0 to -0.15, tail of 60 mm",
    ),
    "half_phase": Simulated(
        MAP_D, "A phase of 0.5 performs poorly compared with 0.2.",
        "loss_by_half_phase_m_per_s", 0.0, inf, "cm/s", 100.0,
        "half of the speed at 0.2, minus the speed at 0.5",
    ),
}  # fmt: skip


class Printed(NamedTuple):
    """A printed number that follows from other numbers of the paper."""

    place: str
    text: str
    stated: float
    computed: float
    digit: float
    """One unit of the last printed digit, the tolerance."""
    unit: str
    calculation: str

    @property
    def agrees(self) -> bool:
        """Whether the stated number follows from the others."""
        return abs(self.stated - self.computed) <= self.digit * (1.0 + 1e-9)


class Given(NamedTuple):
    """A statement that no simulation checks, with its verdict and the reason."""

    place: str
    text: str
    verdict: str
    reason: str


U, V, WAVE, A_T, F = (0.232, 0.22), (1.77, 1.67), (0.28, 0.265), (0.036, 0.039), 6.3
"""Of the table of the optimum, model and experiment: speed [m/s], wave speed [m/s], wavelength [m],
tail amplitude [m]; and the optimal frequency [Hz]."""


def _st(column: int) -> float:
    return 2.0 * A_T[column] * F / U[column]


def _slope(column: int) -> float:
    return A_T[column] / (WAVE[column] / 4.0)


LENGTH = 0.217 / 0.59
"""Length of the robot [m] with which 21.7 cm/s are 0.59 body lengths per second."""

PRINTED: dict[str, Printed] = {
    "time_per_step": Printed(
        "Computational model", "60,000 steps took 76 s, which is 12.0 ms per step.",
        12.0, 76.0 / 60.0, 0.1, "ms", "76 s / 60,000",
    ),
    "tip_with_printed_values": Printed(
        STATIC, "45 kPa in both chambers displace the tip by 102 mm.",
        102.0, 1e3 * uniform_tip(0.298, 0.07, 4.79e-7 * 45e3 / 0.038), 1.0, "mm",
        "K_Q = 479 mm^3, EI = 38,000 N mm^2, and chambers that do not overlap over the whole body "
        "(298 mm, from 0.59 lengths/s); 73 mm if both reach from end to end",
    ),
    "wave_speed_model": Printed(
        PERFORMANCE, "The wave speed is 177 cm/s (model).", 177.0, 1e2 * WAVE[0] * F, 1.0, "cm/s",
        "lambda f = 28 cm x 6.3 Hz",
    ),
    "wave_speed_measured": Printed(
        PERFORMANCE, "The wave speed is 167 cm/s (experiment).", 167.0, 1e2 * WAVE[1] * F, 1.0,
        "cm/s", "lambda f = 26.5 cm x 6.3 Hz",
    ),
    "froude_model": Printed(
        PERFORMANCE, "The Froude efficiency is 0.57 (model).", 0.57, (U[0] + V[0]) / (2 * V[0]),
        0.01, "-", "(U + V)/2V",
    ),
    "froude_measured": Printed(
        PERFORMANCE, "The Froude efficiency is 0.57 (experiment).", 0.57,
        (U[1] + V[1]) / (2 * V[1]), 0.01, "-", "(U + V)/2V",
    ),
    "strouhal_model": Printed(
        PERFORMANCE, "The Strouhal number is 1.96 (model).", 1.96, _st(0), 0.01, "-", "2 A_t f/U",
    ),
    "strouhal_measured": Printed(
        PERFORMANCE, "The Strouhal number is 2.12 (experiment).", 2.12, _st(1), 0.01, "-",
        "2 A_t f/U; with the model's U of 23.2 cm/s it is 2.12",
    ),
    "tail_slope_model": Printed(
        PERFORMANCE, "The tail slope is 0.57 (model).", 0.57, _slope(0), 0.01, "-",
        "A_t/(lambda/4)",
    ),
    "tail_slope_measured": Printed(
        PERFORMANCE, "The tail slope is 0.59 (experiment).", 0.59, _slope(1), 0.01, "-",
        "A_t/(lambda/4)",
    ),
    "length_over_wavelength_measured": Printed(
        "Fig. 8", "The ratio of length to wavelength is 1.4.", 1.4, LENGTH / WAVE[1], 0.1, "-",
        "(21.7 cm/s / 0.59) / 26.5 cm",
    ),
    "selected_slope": Printed(
        "Discussion", "The optimiser selects a tail slope of 0.59.", 0.59, 0.57, 0.01, "-",
        "the model's value in the table",
    ),
    "psi": Printed(
        MULTIMODAL, "172.3 kPa are 25 psi.", 172.3, 25 * 6.894757, 0.1, "kPa",
        "25 x 6.894757 kPa",
    ),
    "strides": Printed(
        SWEEP, "Each test has 20 cycles, of which n = 17 tail beats count.", 17, 20 - 3, 0, "-",
        "20 - 3 transient cycles",
    ),
}  # fmt: skip

GIVEN: dict[str, Given] = {
    "mass": Given(TABLE_1, "Linear mass density of 0.7 kg/m.", INPUT, ""),
    "body_EI": Given(TABLE_1, "Body stiffness of 38000 N mm^2.", INPUT, "changed by the joint fit"),
    "tail_EI": Given(TABLE_1, "Tail stiffness of 5800 N mm^2, of a tail of 70 mm.", INPUT, ""),
    "alpha": Given(
        TABLE_1, "Damping ratio of 5 x 10^-6 s.", INPUT,
        "the built-in robot has 2 ms, because 5e-6 s damp nothing; changed by the joint fit",
    ),
    "height": Given(TABLE_1, "Submerged height of 30 mm.", INPUT, ""),
    "K_Q": Given(
        TABLE_1, "Pressure torque ratio of 479 mm^3.", INPUT, "changed by the joint fit"
    ),
    "k": Given(TABLE_1, "Manifold time constant of 87 ms.", INPUT, "changed by the joint fit"),
    "Q_set": Given(
        TABLE_1, "The torque from the set pressure is 175 mN.", UNDECIDABLE,
        "the unit is that of a moment per length, or a misprint of 175 mN m, which are K_Q x 365 "
        "kPa; the pressure is not given",
    ),
    "water": Given(TABLE_1, "Water density of 1000 kg/m^3.", INPUT, ""),
    "C_d": Given(TABLE_1, "Drag coefficient of 3.0-4.0.", INPUT, ""),
    "m_a": Given(TABLE_1, "Added mass of 0.0-1.0.", INPUT, ""),
    "breaks": Given(TABLE_1, "Break frequencies of 2 Hz and 3 Hz.", INPUT, ""),
    "link": Given(MULTIMODAL, "Rigid head link of l_p = 3 cm.", INPUT, "of `slider climb`"),
    "cap": Given(MULTIMODAL, "Pressures are capped at 172.3 kPa.", INPUT, "of `slider climb`"),
    "cycles": Given(
        MULTIMODAL,
        "Efficiencies are averages over 50 cycles of swimming and 15 cycles of climbing.", INPUT,
        "`slider optimize multimodal` averages over strides of the steady state",
    ),
    "generations": Given(
        GA, "Mutations decrease over 100 generations.", INPUT, "of `slider optimize swim`"
    ),
    "individuals": Given(
        GA, "The optimum was found after 30 generations or 3,360 runs.", INPUT,
        "112 individuals in a generation, the default of `slider optimize swim`",
    ),
    "sweep": Given(
        "Tank tests", "Thrust was measured from 0.4 Hz to 7.0 Hz in steps of 0.2 Hz.", INPUT,
        "of `slider demo`",
    ),
    "nodes": Given(
        "Computational model", "N_p = 51 nodes are adequate.", INPUT,
        "the default mesh; this table uses 31 nodes",
    ),
    "order": Given(
        "Computational model", "The method is of second order in space and first in time.", INPUT,
        "tests of this project measure both orders, with the paper's scheme",
    ),
    "own_speed": Given(
        "Computational model",
        "60,000 steps, 10 seconds of swimming, took 76 seconds on a Platinum 8168 at 2.7 GHz.",
        UNDECIDABLE, "another processor is needed; see docs, performance",
    ),
    "R2": Given(
        SWEEP, "R^2 between the thrusts of model and experiment is 0.95.", UNDECIDABLE,
        "the measured thrusts are not published",
    ),
    "thrust_error": Given(
        FIG_6, "The net thrust of the model has an error of 7 % at 4.8 Hz.", UNDECIDABLE,
        "the measured thrust is not published",
    ),
    "force_efficiency": Given(
        PERFORMANCE, "The force efficiency is 0.31 (model).", UNDECIDABLE, "it is not defined"
    ),
    "frequency_gain": Given(
        "Discussion", "The optimal design increases the tail beat frequency by 20 %.", UNDECIDABLE,
        "the frequency before is not given: 6.3 Hz are 26 % above 5 Hz and 31 % above 4.8 Hz",
    ),
    "improvement": Given(
        "Conclusions", "The swimming performance improved by 178 %.", UNDECIDABLE,
        "the speed before is not given (21.7 cm/s / 2.78 would be 7.8 cm/s)",
    ),
    "slightly_shorter": Given(
        MAP_C, "Model and experiment agree on the tail length of the largest speed; the model's "
        "is slightly shorter than the experiment's.", INCONSISTENT,
        "the text says both, and changes the optimal tail from 53 to 70 mm for the experiment",
    ),
    "overpredicts": Given(
        MAP_C, "The model overpredicts the speed at 17 mN m^2.", UNDECIDABLE,
        "the measured speeds are not in the text",
    ),
    "load": Given(
        STATIC, "A lateral load of 490 mN at the tip gave EI.", UNDECIDABLE,
        "deflection and distance are not given",
    ),
    "second_mode": Given(
        FIG_6, "At 4.8 Hz, the body follows its second mode; the thrust is more sinusoidal.",
        UNDECIDABLE, "the paper gives no number for either",
    ),
    "concavity": Given(
        ONE_HZ, "The body changes its concavity between 0 and 10 and between 50 and 60 % of a "
        "stride (axis from 0 to 90).", UNDECIDABLE, "the phase of the rear chamber is not given",
    ),
    "tail_thrust": Given(
        "Fig. 8", "The thrust of the tail is largest at phase 0 and 1/2.", UNDECIDABLE,
        "the instant of phase 0 is not given",
    ),
    "near_peak": Given(
        MAP_A, "5 Hz is very close to the frequency of the largest head-fixed thrust.", INPUT,
        "follows from the peak at 4.8 Hz",
    ),
    "other_gaits": Given(
        "Discussion", "Others found a tail slope of 1 best, and Strouhal numbers of 0.3 to 2.",
        OMITTED, "results of other authors",
    ),
    "tank": Given(
        "Tank tests", "Tank of 185 cm x 46 cm x 58 cm, filled to 25 cm.", OMITTED,
        "the water of the model is unbounded",
    ),
    "supply": Given("Tank tests", "Supply of 760 kPa.", OMITTED, ""),
    "recording": Given(
        "Tank tests",
        "Forces at 10 kHz; video at 60 FPS (1920 x 1080) and 400 FPS (768 x 288); Vicon at 300 Hz.",
        OMITTED, "",
    ),
    "parts": Given(
        "Tank tests", "Motor driver DRV8838, part no. 2990; chambers 1 and 3, and 2 and 4 are "
        "antagonists.", OMITTED, "",
    ),
    "tails": Given(
        "Tethered swimming", "Tail lengths differ by 4 cm in the experiment.", OMITTED, ""
    ),
    "half_phase_valves": Given(
        "Discussion", "A phase shift of 180 degrees or 0.5 is simple with five-way valves.",
        OMITTED, "",
    ),
}  # fmt: skip
