"""What a search of the unit box is, whatever its algorithm."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np


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
