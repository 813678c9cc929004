"""The list of the paper's statements: no number is missing, and tolerances mean what they say."""

import re

import numpy as np
import pytest

from slider_jax.statements.facts import NAMES, facts
from slider_jax.statements.quantities import CHANGED, COARSE, HeadFixed, Quantities
from slider_jax.statements.statements import (
    GIVEN,
    PRINTED,
    SIMULATED,
    VERDICTS,
    Simulated,
    uniform_tip,
)
from slider_jax.swimming.performance import Performance
from tests.support.data import data_dir

EQUATIONS = r"\\begin\{(equation|align)\}.*?\\end\{\1\}"
REFERENCES = r"\\(cite|ref|label|includegraphics)(\[[^\]]*\])?\{[^}]*\}"
NUMBER = re.compile(r"(?<![A-Za-z_{^\\\d.])\d+(?:[.,]\d+)*")
"""A number that is no index, exponent or argument of a LaTeX command."""
OF_FORMULAS = {"0", "1", "2", "3"}
"""Numbers below 4 also occur in formulas, names of chambers and dimensions."""


def paper_text() -> str:
    folder = data_dir()
    path = None if folder is None else folder.parent / "paper" / "slider_paper.tex"
    if path is None or not path.exists():
        pytest.skip("the paper's text (../shared/paper/slider_paper.tex) is not at hand")
    text = path.read_text(encoding="utf-8")
    body = text[text.index(r"\begin{abstract}") : text.index(r"\section*{Acknowledgments}")]
    body = re.sub(EQUATIONS, "", body, flags=re.S)
    body = re.sub(r"\\SI\{~?([\d.]+)\}", r" \1 ", re.sub(REFERENCES, "", body))
    return re.sub(r"(?<!\\)%.*", "", body)


def test_every_number_of_the_papers_text_is_in_a_statement():
    listed = " ".join(
        one.text for table in (SIMULATED, PRINTED, GIVEN) for one in table.values()
    ).replace(",", "")
    known = {float(x) for x in NUMBER.findall(listed)}
    numbers = {x.replace(",", "") for x in NUMBER.findall(paper_text())}
    missing = {x for x in numbers - OF_FORMULAS if float(x) not in known}
    assert len(numbers) > 80
    assert missing == set()


def test_at_least_45_statements_are_checked_or_judged():
    assert len(SIMULATED) + len(PRINTED) >= 45
    names = [*SIMULATED, *PRINTED, *GIVEN]
    assert len(set(names)) == len(names)


def test_the_papers_own_numbers_contradict_five_statements():
    wrong = {name for name, one in PRINTED.items() if not one.agrees}
    assert wrong == {
        "time_per_step", "tip_with_printed_values", "strouhal_measured", "tail_slope_model",
        "selected_slope",
    }  # fmt: skip
    assert {one.verdict for one in GIVEN.values()} <= set(VERDICTS)
    # With the model's speed in place of the measured one, the measured Strouhal number agrees.
    assert 2 * 0.039 * 6.3 / 0.232 == pytest.approx(2.12, abs=0.01)


def test_the_tip_of_an_arc():
    """A quarter circle: R = 2 L/pi; the tail points across."""
    radius = 0.3 / (np.pi / 2)
    assert uniform_tip(0.3, 0.05, 1.0 / radius) == pytest.approx(radius + 0.05)


def test_a_miss_of_one_is_the_end_of_the_tolerance():
    both = Simulated("", "", "x", 0.9, 1.1)
    assert both.miss(1.0) == 0.0 and both.miss(1.1) == pytest.approx(1.0)
    assert both.miss(1.3) == pytest.approx(3.0)
    least = Simulated("", "", "x", 2.0, np.inf)
    assert least.miss(5.0) == 0.0 and least.miss(1.8) == pytest.approx(2.0)
    assert both.miss(np.nan) == 100.0 and not both.agrees(np.nan)


def of_strides(thrust, tip, share):
    n = len(COARSE.frequencies) + len(CHANGED)
    return HeadFixed(thrust, share * np.ones(n), tip, np.zeros(n))


def quantities_with(**swims):
    """Quantities with a thrust of -(f - 1)^2 below 2.6 Hz and 60 - 20 |f - 4.8| mN above."""
    f = np.array(COARSE.frequencies)
    thrust = 1e-3 * np.where(f < 2.6, (f - 1.0) ** 2 - 30.0, 60.0 - 20.0 * np.abs(f - 4.8))
    thrust = np.append(thrust, [0.05, 0.05, 0.02])
    tip = np.append(0.1 / f, [0.018, 0.0208, 0.021])
    fields = {name: np.ones(len(NAMES)) for name in Performance.__dataclass_fields__}
    speed = np.array([swims.get(name, 0.2) for name in NAMES])
    fields |= {"speed": speed, "shape_wavelength": 0.28 * np.ones(len(NAMES))}
    fields |= {"tail_amplitude": 0.036 * np.ones(len(NAMES))}
    return Quantities(0.102, 0.5, of_strides(thrust, tip, 0.6), Performance(**fields))


def test_facts_are_read_from_the_quantities():
    x = quantities_with(optimum=0.232, **{"7d 0.1": 0.213, "7d -0.15": 0.1, "frequency 7": 0.3})
    found = facts(x, COARSE)
    assert found["sweep_minimum_Hz"] == pytest.approx(1.0)
    assert found["sweep_peak_Hz"] == pytest.approx(4.8, abs=0.05)
    assert found["roll_off_N_per_Hz"] == pytest.approx(0.020, rel=0.05)
    assert found["tip_by_C_d"] == pytest.approx(0.018 / (0.1 / 4.8) - 1.0)
    assert found["thrust_by_m_a_N"] == pytest.approx(0.01)  # 60 - 50 mN; 50 - 20 mN is larger
    assert found["thrust_without_m_a_N"] == 0.02 and found["least_rise_N"] > 0.0
    assert found["wave_speed_m_per_s"] == pytest.approx(0.28 * 6.3)
    assert found["length_over_wavelength_70_mm"] == pytest.approx(0.368 / 0.28)
    assert found["gain_by_frequency_m_per_s"] == pytest.approx(0.3 - 0.232)
    assert found["gain_by_phase_m_per_s"] == pytest.approx(0.2 - 0.232)
    assert found["loss_by_negative_phase_m_per_s"] == pytest.approx(0.1)
    assert 0.05 < found["best_phase"] < 0.15


def test_a_failed_simulation_agrees_with_nothing_that_needs_it():
    x = quantities_with()
    lost = x._replace(swims=Performance(**{k: np.nan * v for k, v in vars(x.swims).items()}))
    found = facts(lost, COARSE)
    agree = {name: one.agrees(found[one.fact]) for name, one in SIMULATED.items()}
    assert agree["sweep_peak"] and agree["static_tip"]
    needing = ("speed", "optimal_frequency", "best_phase", "half_phase")
    assert not any(agree[name] for name in needing)


def test_one_missing_value_leaves_no_extremum():
    """A failed frequency may hide the peak, and a failed neighbour a faster one."""
    x = quantities_with()
    thrust = np.array(x.sweep.thrust)
    thrust[7] = np.nan
    found = facts(x._replace(sweep=x.sweep._replace(thrust=thrust)), COARSE)
    assert np.isnan(found["sweep_peak_N"]) and np.isnan(found["sweep_minimum_Hz"])
    slow = facts(quantities_with(**{"frequency 7": np.nan}), COARSE)
    assert np.isnan(slow["gain_by_frequency_m_per_s"]) and slow["gain_by_phase_m_per_s"] == 0.0
