"""Peak memory and speed of a population of free swimmers, each a design of its own.

    python benchmarks/population.py --members 1000 --seconds 10

Members swim from rest at 5 Hz for whole strides, 96 steps each on 31 nodes, as a search compares
them. Memory is the whole process's, compiler and libraries with it.
"""

import argparse
import json
import resource
import time

import jax
import jax.numpy as jnp
import numpy as np

from slider_jax.batch.chunks import available_cores
from slider_jax.dynamics.step import at_rest
from slider_jax.io.files import versions
from slider_jax.optimise.design_space import gait_bounds, models
from slider_jax.optimise.population import Evaluation, start_devices
from slider_jax.precision import enable_float64
from slider_jax.swimming.paper_optimum import optimum
from slider_jax.swimming.steady_state import SteadySettings, simulate_strides

FREQUENCY = 5.0


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--members", type=int, default=1000)
    asked.add_argument("--seconds", type=float, default=10.0, help="swum by each")
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    enable_float64()
    start_devices(available_cores())
    model, box, search = models(optimum()), gait_bounds({}), SteadySettings()
    count = round(given.seconds * FREQUENCY)

    def speed(unit):
        swimmer = model(box.gait(unit)._replace(frequency=jnp.asarray(FREQUENCY)))
        start = at_rest(swimmer, search.numerics)
        carry, pace = simulate_strides(swimmer, FREQUENCY, start, count, search)
        return jnp.where(carry.ok, pace.speed, jnp.nan)

    evaluate = Evaluation(speed)
    designs = np.random.default_rng(given.seed).uniform(size=(given.members, 6))
    evaluate(designs[:1])
    compiled, begun = _peak(), time.perf_counter()
    speeds = evaluate(designs)
    wall = time.perf_counter() - begun
    print(json.dumps({
        "members": given.members,
        "simulated_s_each": count / FREQUENCY,
        "failed": int(np.isnan(speeds).sum()),
        "peak_GiB": _peak(),
        "peak_GiB_compiled": compiled,
        "wall_s": wall,
        "simulated_s_per_s": given.members * count / FREQUENCY / wall,
        "devices": len(jax.devices()),
        "versions": versions(),
    }, indent=1))  # fmt: skip


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


if __name__ == "__main__":
    main()
