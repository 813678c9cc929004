"""The algorithms of a search, by name."""

from collections.abc import Callable

from slider_jax.errors import InputError
from slider_jax.optimise.evolution import ELITE, cma_es, genetic
from slider_jax.optimise.gradient_ascent import ASCENDERS, gradient
from slider_jax.optimise.optimiser import Searcher

SEARCHERS: dict[str, Callable[[int, int], Searcher]] = {
    "genetic": genetic,
    "gradient": gradient,
    "cma-es": cma_es,
}
LEAST = {"genetic": 2 * ELITE, "gradient": ASCENDERS, "cma-es": 4}
"""Members that an algorithm needs."""


def searcher(name: str, members: int, dimensions: int) -> Searcher:
    """An algorithm by name. Raises `InputError` for a population that it cannot work with."""
    if members < LEAST[name]:
        raise InputError.value("--population", members, f"{LEAST[name]} or more members")
    return SEARCHERS[name](members, dimensions)
