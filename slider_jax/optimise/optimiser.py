"""Defines optimisers. All variables of a design are scaled to the range 0 to 1 (the unit box).

All optimisers maximise a score. evosax and optax minimise, so they get minus the score.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from evosax.algorithms import CMA_ES, SimpleGA
from evosax.algorithms.population_based.simple_ga import mutation
from scipy.stats import qmc

from slider_jax.errors import InputError


class Optimiser(NamedTuple):
    """An algorithm that maximises a score: `ask` gives a population, `tell` takes its scores.

    The state is a tree of arrays. Random numbers depend on the seed and the generation only, so an
    optimisation that resumes from a saved state gives the same result as an uninterrupted one. An
    individual whose score is not finite counts as the worst.
    """

    name: str
    begin: Callable[[int], Any]
    """Returns the state before the first generation. The argument is the seed."""
    ask: Callable[[Any, int, int], tuple[np.ndarray, Any]]
    """Returns (population (n, d), state). Arguments: state, seed, number of the generation."""
    tell: Callable[[Any, int, int, np.ndarray, np.ndarray, np.ndarray | None], Any]
    """Returns the next state. Arguments: state, seed, number of the generation, population, scores
    (n,), and gradients (n, d) if `wants_gradients`."""
    wants_gradients: Callable[[int], bool] = lambda generation: False
    """Whether the optimiser needs the gradients of a generation."""
    cost: int = 1
    """One evaluation with gradient counts as this number of evaluations."""


def standard(call: Callable[..., Any]) -> Callable[..., Any]:
    """Wraps a library call that mixes dtypes, which strict dtype promotion would reject."""

    def inner(*arguments: Any) -> Any:
        with jax.numpy_dtype_promotion("standard"):
            return call(*arguments)

    return inner


ASCENT_STARTS = 8
"""Number of individuals of the first generation from which gradient ascent continues."""
STEP, STEPS, LAST = 0.08, 30, 0.05
"""Cosine schedule of Adam's learning rate: initial value as a fraction of the bounds' width, number
of generations, and final value as a fraction of the initial value."""
COST = 3
"""One evaluation with gradient counts as this number of evaluations: the ratio of the computing
times with and without gradient, rounded up."""


def gradient(population: int, dimensions: int) -> Optimiser:
    """Returns gradient ascent from the best individuals of the first generation.

    The first generation consists of scrambled Sobol points. Adam computes the steps. Points outside
    the unit box are moved to its faces. Source: Kingma, D. P., Ba, J. (2015), Adam: a method for
    stochastic optimization, ICLR.
    """
    adam = optax.adam(optax.cosine_decay_schedule(STEP, STEPS, LAST), b1=0.7, b2=0.9)

    def begin(seed):
        sobol = qmc.Sobol(dimensions, rng=np.random.default_rng(seed))
        first = sobol.random_base2(max(1, int(np.ceil(np.log2(population)))))[:population]
        return {"members": first, "climb": adam.init(jnp.zeros((ASCENT_STARTS, dimensions)))}

    def ask(state, seed, generation):
        return np.asarray(state["members"]), state

    def tell(state, seed, generation, found, scores, slopes):
        good = np.where(np.isfinite(scores), scores, -np.inf)
        if slopes is None:
            best = np.argsort(-good, kind="stable")[:ASCENT_STARTS]
            return state | {"members": found[best]}
        # The gradient of a failed individual is set to 0; Adam's momentum still moves it.
        slopes = jnp.asarray(np.where(np.isfinite(slopes), slopes, 0.0))
        change, climb = adam.update(-slopes, state["climb"])
        return {"members": np.clip(found + np.asarray(change), 0.0, 1.0), "climb": climb}

    return Optimiser(
        "gradient", standard(begin), ask, standard(tell), lambda generation: generation > 0, COST
    )


DECAY = 100
"""Number of generations over which the size of mutations decreases (the paper's value)."""
MUTATION = (0.15, 0.002)
"""Standard deviation of mutations in the first generation and from generation `DECAY` on, as a
fraction of the bounds' width."""
PRESSURE = 1.8
"""Selection pressure: expected number of offspring of the best individual. The worst individual has
2 - PRESSURE expected offspring. The mean over the population is 1."""
ELITE = 2
"""Number of best individuals that each generation copies unchanged."""
SPREAD = 0.3
"""Initial standard deviation of CMA-ES, as a fraction of the bounds' width."""


class RankGA(SimpleGA):
    """Genetic algorithm with linear ranking, uniform crossover, normal mutation and elitism.

    Stochastic universal sampling selects the parents. Sources: Baker, J. E. (1985), Adaptive
    selection methods for genetic algorithms; (1987), Reducing bias and inefficiency in the
    selection algorithm.
    """

    def _ask(self, key, state, params):
        n = self.population_size
        ranked = state.population[jnp.argsort(state.fitness)]
        place = jnp.arange(float(n))
        share = (PRESSURE - 2.0 * (PRESSURE - 1.0) * place / (n - 1)) / n
        one, other, mate, order, moved = jax.random.split(key, 5)

        def sampled(key):
            pointers = (jax.random.uniform(key) + place) / n
            chosen = jnp.searchsorted(jnp.cumsum(share), pointers)
            return ranked[jnp.minimum(chosen, n - 1)]

        mothers = sampled(one)
        fathers = sampled(other)[jax.random.permutation(order, n)]
        children = jnp.where(jax.random.bernoulli(mate, 0.5, mothers.shape), mothers, fathers)
        children = jax.vmap(mutation, (0, 0, None))(jax.random.split(moved, n), children, state.std)
        # The first rows of the next population are copies of the best individuals.
        return jnp.clip(children, 0.0, 1.0).at[:ELITE].set(ranked[:ELITE]), state


def _key(seed: int, generation: int, use: int) -> jax.Array:
    return jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), generation), use)


def _losses(scores: np.ndarray) -> jax.Array:
    """Returns minus the scores, because evosax minimises. A score that is not finite is worst."""
    scores = np.asarray(scores, float)
    good = np.isfinite(scores)
    worst = scores[good].min() - 1.0 if good.any() else 0.0
    return jnp.asarray(-np.where(good, scores, worst))


MUTATION_SCHEDULE = optax.linear_schedule(*MUTATION, DECAY)
"""Standard deviation of mutations as a function of the generation number."""


@cache
def _shared(algorithm: type, population: int, dimensions: int, *options: Any) -> Any:
    """Returns the same evosax object for equal arguments. evosax compiles once for each object."""
    return algorithm(population, jnp.zeros(dimensions), *options)


def genetic(population: int, dimensions: int) -> Optimiser:
    """Returns the paper's genetic algorithm."""
    ga = _shared(RankGA, population, dimensions, MUTATION_SCHEDULE)
    params = ga.default_params

    def begin(seed):
        first = jax.random.uniform(_key(seed, 0, 0), (population, dimensions))
        return ga.init(_key(seed, 0, 1), first, jnp.zeros(population), params)

    def ask(state, seed, generation):
        if generation == 0:
            return np.asarray(state.population), state
        found, state = ga.ask(_key(seed, generation, 0), state, params)
        return np.asarray(found), state

    def tell(state, seed, generation, found, scores, slopes):
        key = _key(seed, generation, 1)
        return ga.tell(key, jnp.asarray(found), _losses(scores), state, params)[0]

    return Optimiser("genetic", standard(begin), standard(ask), standard(tell))


def cma_es(
    population: int, dimensions: int, around: np.ndarray | None = None, spread: float = SPREAD
) -> Optimiser:
    """Returns CMA-ES (covariance matrix adaptation).

    Points outside the unit box are moved to its faces. The initial distribution has the mean
    `around` (default: the centre of the box) and the standard deviation `spread`, as a fraction of
    the bounds' width.
    """
    middle = np.full(dimensions, 0.5) if around is None else around
    es = _shared(CMA_ES, population, dimensions)

    def begin(seed):
        params = es.default_params.replace(std_init=spread)
        return es.init(_key(seed, 0, 0), jnp.asarray(middle), params)

    def ask(state, seed, generation):
        found, state = es.ask(_key(seed, generation, 0), state, es.default_params)
        return np.clip(np.asarray(found), 0.0, 1.0), state

    def tell(state, seed, generation, found, scores, slopes):
        key = _key(seed, generation, 1)
        return es.tell(key, jnp.asarray(found), _losses(scores), state, es.default_params)[0]

    return Optimiser("cma-es", standard(begin), standard(ask), standard(tell))


OPTIMISERS: dict[str, tuple[int, Callable[[int, int], Optimiser]]] = {
    "genetic": (2 * ELITE, genetic),
    "gradient": (ASCENT_STARTS, gradient),
    "cma-es": (4, cma_es),
}
"""Smallest population of each algorithm, and the function that returns the optimiser."""


def make_optimiser(name: str, population: int, dimensions: int) -> Optimiser:
    """Returns an optimiser by name. Raises `InputError` for a population that is too small."""
    fewest, algorithm = OPTIMISERS[name]
    if population < fewest:
        raise InputError.value("--population", population, f"{fewest} or more individuals")
    return algorithm(population, dimensions)
