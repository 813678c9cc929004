"""What a search of the unit box is, whatever its algorithm."""

from collections.abc import Callable
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
    """An algorithm for one size of population, asked and told by generation; it maximises.

    The state is a tree of arrays. What is drawn follows from the seed and the generation alone, so
    that a search goes on from a kept state as if it had not been stopped. A member whose score is
    not finite counts as the worst.
    """

    name: str
    begin: Callable[[int], Any]
    """The state before the first generation, from the seed."""
    ask: Callable[[Any, int, int], tuple[np.ndarray, Any]]
    """(members (n, d) in the unit box, state) of a state, the seed and the generation."""
    tell: Callable[[Any, int, int, np.ndarray, np.ndarray, np.ndarray | None], Any]
    """The state after members, their scores (n,), and their gradients (n, d) if asked for."""
    wants_gradients: Callable[[int], bool] = lambda generation: False
    """Whether a generation is to be scored with gradients."""
    cost: int = 1
    """Evaluations that one with its gradient is counted for."""


def standard(call: Callable[..., Any]) -> Callable[..., Any]:
    """`call` of a library that mixes types, where strict promotion would forbid it."""

    def inner(*arguments: Any) -> Any:
        with jax.numpy_dtype_promotion("standard"):
            return call(*arguments)

    return inner


ASCENT_STARTS = 8
"""Members that go on from the first generation."""


STEP, STEPS, LAST = 0.08, 30, 0.05
"""First step of a climb, of the bounds' width; the generations over which it falls, and to what
share of itself."""


COST = 3
"""Evaluations that one with its gradient is counted for: its time in theirs, rounded up."""


def gradient(members: int, dimensions: int) -> Optimiser:
    """Scrambled Sobol points first; then the best climb by Adam, kept within the box.

    Source: Kingma, D. P., Ba, J. (2015), Adam: a method for stochastic optimization, ICLR.
    """
    adam = optax.adam(optax.cosine_decay_schedule(STEP, STEPS, LAST), b1=0.7, b2=0.9)

    def begin(seed):
        sobol = qmc.Sobol(dimensions, rng=np.random.default_rng(seed))
        first = sobol.random_base2(max(1, int(np.ceil(np.log2(members)))))[:members]
        return {"members": first, "climb": adam.init(jnp.zeros((ASCENT_STARTS, dimensions)))}

    def ask(state, seed, generation):
        return np.asarray(state["members"]), state

    def tell(state, seed, generation, found, scores, slopes):
        good = np.where(np.isfinite(scores), scores, -np.inf)
        if slopes is None:
            best = np.argsort(-good, kind="stable")[:ASCENT_STARTS]
            return state | {"members": found[best]}
        # A member that failed goes on as its last steps led it.
        slopes = jnp.asarray(np.where(np.isfinite(slopes), slopes, 0.0))
        change, climb = adam.update(-slopes, state["climb"])
        return {"members": np.clip(found + np.asarray(change), 0.0, 1.0), "climb": climb}

    return Optimiser(
        "gradient", standard(begin), ask, standard(tell), lambda generation: generation > 0, COST
    )


DECAY = 100
"""Generations over which mutation falls (the paper's)."""


MUTATION = (0.15, 0.002)
"""Standard deviation of a mutation at first and after `DECAY` generations, of a bound's width."""


PRESSURE = 1.8
"""Offspring expected of the best member, where the mean is 1; the worst has the rest to 2."""


ELITE = 2
"""Members that are copied unchanged."""


SPREAD = 0.3
"""Standard deviation that CMA-ES starts with, of a bound's width."""


class RankGA(SimpleGA):
    """Fitness linear in rank, uniform crossover, normal mutation within the box, an elite kept.

    Parents are drawn by stochastic universal sampling with linear ranking (Baker, J. E. (1985),
    Adaptive selection methods for genetic algorithms; (1987), Reducing bias and inefficiency in the
    selection algorithm).
    """

    def _ask(self, key, state, params):
        n = self.population_size
        ranked = state.population[jnp.argsort(state.fitness)]
        place = jnp.arange(float(n))
        share = (PRESSURE - 2.0 * (PRESSURE - 1.0) * place / (n - 1)) / n
        one, other, mate, order, moved = jax.random.split(key, 5)

        def drawn(key):
            pointers = (jax.random.uniform(key) + place) / n
            chosen = jnp.searchsorted(jnp.cumsum(share), pointers)
            return ranked[jnp.minimum(chosen, n - 1)]

        mothers = drawn(one)
        fathers = drawn(other)[jax.random.permutation(order, n)]
        children = jnp.where(jax.random.bernoulli(mate, 0.5, mothers.shape), mothers, fathers)
        children = jax.vmap(mutation, (0, 0, None))(jax.random.split(moved, n), children, state.std)
        # The best are the first of the next population, as they are.
        return jnp.clip(children, 0.0, 1.0).at[:ELITE].set(ranked[:ELITE]), state


def _key(seed: int, generation: int, use: int) -> jax.Array:
    return jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), generation), use)


def _losses(scores: np.ndarray) -> jax.Array:
    """To be minimised; finite, as what is not would spoil weights and means."""
    scores = np.asarray(scores, float)
    good = np.isfinite(scores)
    worst = scores[good].min() - 1.0 if good.any() else 0.0
    return jnp.asarray(-np.where(good, scores, worst))


def genetic(members: int, dimensions: int) -> Optimiser:
    """The paper's genetic algorithm."""
    schedule = optax.linear_schedule(*MUTATION, DECAY)
    ga = RankGA(members, jnp.zeros(dimensions), schedule)
    params = ga.default_params

    def begin(seed):
        first = jax.random.uniform(_key(seed, 0, 0), (members, dimensions))
        return ga.init(_key(seed, 0, 1), first, jnp.zeros(members), params)

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
    members: int, dimensions: int, around: np.ndarray | None = None, spread: float = SPREAD
) -> Optimiser:
    """Covariance matrix adaptation; members beyond the box are put on its faces.

    It starts `around` a point (the middle), with `spread` as its standard deviation.
    """
    middle = np.full(dimensions, 0.5) if around is None else around
    es = CMA_ES(members, jnp.zeros(dimensions))

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
        raise InputError.value(
            "--population", members, f"{SMALLEST_POPULATION[name]} or more members"
        )
    return OPTIMISERS[name](members, dimensions)
