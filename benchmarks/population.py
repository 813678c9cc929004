"""Measures peak memory and speed of a population of free swimmers with different designs.

    python benchmarks/population.py --members 1000 --seconds 10

Each swimmer starts from rest and swims whole strides at 5 Hz, with 96 time steps per stride and 31
nodes, as in the optimisation. The reported memory is the peak of the whole process.
"""

import argparse
import json
import resource
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from record import write_record

from slider_jax.batch.chunks import available_cores
from slider_jax.dynamics.step import at_rest
from slider_jax.optimise.design_space import gait_bounds, models
from slider_jax.optimise.population import Evaluation, start_devices
from slider_jax.precision import enable_float64
from slider_jax.swimming.paper_optimum import optimum
from slider_jax.swimming.steady_state import SteadySettings, simulate_strides

FREQUENCY = 5.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--members", type=int, default=1000, help="number of swimmers (default: 1000)")
    add("--seconds", type=float, default=10.0, help="simulated time in s (default: 10)")
    add("--seed", type=int, default=0, help="seed of the random designs (default: 0)")
    add("--out", type=Path, help="file for the record (default: none)")
    arguments = parser.parse_args()
    enable_float64()
    start_devices(available_cores())
    model, box, search = models(optimum()), gait_bounds({}), SteadySettings()
    count = round(arguments.seconds * FREQUENCY)

    def speed(unit):
        swimmer = model(box.gait(unit)._replace(frequency=jnp.asarray(FREQUENCY)))
        start = at_rest(swimmer, search.numerics)
        carry, pace = simulate_strides(swimmer, FREQUENCY, start, count, search)
        return jnp.where(carry.ok, pace.speed, jnp.nan)

    evaluate = Evaluation(speed)
    designs = np.random.default_rng(arguments.seed).uniform(size=(arguments.members, 6))
    evaluate(designs[:1])
    compiled, start = _peak(), time.perf_counter()
    speeds = evaluate(designs)
    wall = time.perf_counter() - start
    figures = {
        "members": arguments.members,
        "simulated_s_each": count / FREQUENCY,
        "failed": int(np.isnan(speeds).sum()),
        "peak_GiB": _peak(),
        "peak_GiB_compiled": compiled,
        "wall_s": wall,
        "simulated_s_per_s": arguments.members * count / FREQUENCY / wall,
        "devices": len(jax.devices()),
    }
    print(json.dumps(figures, indent=1))
    if arguments.out:
        write_record(arguments.out, figures)


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


if __name__ == "__main__":
    main()
