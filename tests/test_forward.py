"""Programs that threads share."""

import time
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp

from calibration.forward import _Program


def test_threads_that_ask_at_once_make_a_program_once():
    traced = []

    def double(x):
        traced.append(x.shape)
        time.sleep(0.1)
        return 2.0 * x

    program = _Program(double)
    with ThreadPoolExecutor(4) as pool:
        out = list(pool.map(program, [jnp.full(3, float(i)) for i in range(4)]))
        assert [float(y[0]) for y in out] == [0.0, 2.0, 4.0, 6.0]
        list(pool.map(program, [jnp.ones(5)] * 4))
    assert traced == [(3,), (5,)]
