"""The algorithms of a search, by name."""

from collections.abc import Callable

from slider_jax.errors import InputError
from slider_jax.optimise.evolution import ELITE, cma_es, genetic
from slider_jax.optimise.gradient_ascent import ASCENT_STARTS, gradient
from slider_jax.optimise.optimiser import Optimiser

OPTIMISERS: dict[str, Callable[[int, int], Optimiser]] = {
    "genetic": genetic,
    "gradient": gradient,
    "cma-es": cma_es,
}
SMALLEST_POPULATION = {"genetic": 2 * ELITE, "gradient": ASCENT_STARTS, "cma-es": 4}
"""Members that an algorithm needs."""


def make_optimiser(name: str, members: int, dimensions: int) -> Optimiser:
    """An algorithm by name. Raises `InputError` for a population that it cannot work with."""
    if members < SMALLEST_POPULATION[name]:
        raise InputError.value("--population", members, f"{SMALLEST_POPULATION[name]} or more members")
    return OPTIMISERS[name](members, dimensions)
