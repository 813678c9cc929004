"""A file with an effect of the user's own, and a library that is restored after use."""

from contextlib import contextmanager

from slider_jax.effects.library import LIBRARY
from slider_jax.io.files import LOADED_FILES

WALL_FRICTION = '''"""Friction along the body."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import (
    BendingMoment, Effect, ForceDensity, WakeForce, parameter, shape_parameter
)


class WallFriction(ForceDensity):
    """F_tau = -c u_tau. Source: this test."""

    title = "friction at a wall"

    c: Scalar = parameter(0.0, 0.0, 10.0, "N s/m^2", "the range of this test")
    exponent: Scalar = shape_parameter(0.0, 0.0, 1.0, "-", "the range of this test")

    def force(self, x):
        return -self.c * x.u_tau * (1.0 + x.u_tau**2) ** self.exponent, jnp.zeros_like(x.u_n)
'''


@contextmanager
def restored_library():
    """Removes loaded effects at the end, as the end of a process does; yields the library."""
    before, files = dict(LIBRARY), dict(LOADED_FILES)
    try:
        yield before
    finally:
        LIBRARY.clear()
        LIBRARY.update(before)
        LOADED_FILES.clear()
        LOADED_FILES.update(files)


def write_effect(path, *changes):
    """Writes the file of `WALL_FRICTION` with each (old, new) of `changes`; returns its path."""
    text = WALL_FRICTION
    for old, new in changes:
        assert old in text, f"{old!r} is not in the file"
        text = text.replace(old, new, 1)
    path.write_text(text)
    return path
