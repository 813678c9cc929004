"""The gradient-assisted search: evenly spread members, and the best of them climb."""

import jax.numpy as jnp
import numpy as np
import optax
from scipy.stats import qmc

from slider_jax.optimise.optimiser import Optimiser, standard

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
