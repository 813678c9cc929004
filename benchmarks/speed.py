"""Measures the simulator's speed on one core, and compares it with PyElastica's speed.

    python benchmarks/speed.py --peer-python /path/to/python/with/pyelastica --out speed.json

A cost is the CPU time of one core divided by the simulated time, and in a batch also divided by the
number of robots. The smallest cost of several repeats is reported. The benchmark also measures the
error with the timed mesh and time step, the cost of derivatives, and the cost without the compiled
solver. Without `--peer-python`, PyElastica is omitted. `--growth` adds tables and a plot of the
cost against the number of nodes and the batch size, and the memory of the batches.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent
FIRST_CALL = """
import time; start = time.perf_counter()
import sys; sys.path.insert(0, {here!r})
import jax
jax.config.update("jax_compilation_cache_dir", {cache!r})
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
from slider_jax.programs import compiled_once, kept_programs
from cases import model, run
with kept_programs():  # as in a command
    jax.block_until_ready(compiled_once(run)(model()))
print(time.perf_counter() - start)
"""


def least_cpu_seconds(call, repeats: int) -> float:
    """Returns the CPU seconds of the fastest of `repeats` calls."""
    import jax

    spent = []
    for _ in range(repeats):
        start = time.process_time()
        jax.block_until_ready(call())
        spent.append(time.process_time() - start)
    return min(spent)


def accuracy(**robot) -> dict:
    """Returns the error of the timed mesh and time step relative to a fine mesh and time step."""
    import jax
    from cases import NODES, STEPS, mean_thrust_and_range, model, run

    fine = (201, 1000)
    timed = mean_thrust_and_range(jax.jit(run)(model(**robot))[0], STEPS)
    exact = mean_thrust_and_range(jax.jit(lambda m: run(m, *fine))(model(**robot))[0], fine[1])
    error = timed / exact - 1.0
    return {
        "nodes": NODES,
        "steps_per_stride": STEPS,
        "fine_nodes_and_steps": fine,
        "mean_thrust_N": exact[0],
        "mean_thrust_error": error[0],
        "tip_range_error": error[1],
    }


def batch_of(members: int, chunk: int = 8):
    """Returns a function that simulates a batch in chunks that fit the cache, and its argument."""
    import jax
    import jax.numpy as jnp
    from cases import model, run, with_amplitude

    base = model()

    def member(amplitude):
        series, ok = run(with_amplitude(base, amplitude))
        return series[-1], ok

    call = jax.jit(lambda a: jax.lax.map(member, a, batch_size=min(chunk, members)))
    return call, jnp.linspace(150e3, 300e3, members)


def batch_cost(members: int, repeats: int) -> float:
    """Returns a batch's cost per robot and simulated second."""
    import jax
    from cases import SECONDS

    call, amplitudes = batch_of(members)
    assert bool(jax.block_until_ready(call(amplitudes))[1].all())
    return least_cpu_seconds(lambda: call(amplitudes), repeats) / (members * SECONDS)


def single_cost(repeats: int, nodes=None, **robot) -> float:
    """Returns the cost of one robot per simulated second, without compilation."""
    import jax
    from cases import NODES, SECONDS, model, run

    call = jax.jit(lambda m: run(m, nodes or NODES))
    one = model(**robot)
    assert bool(jax.block_until_ready(call(one))[1])
    return least_cpu_seconds(lambda: call(one), repeats) / SECONDS


def gradient_ratio(repeats: int) -> float:
    """Returns the cost of the thrust's forward derivatives divided by the cost of the thrust.

    The derivatives are with respect to C_d, m_a, k and K_Q.
    """
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    from cases import STEPS, model, run

    base = model()
    where = lambda m: (  # noqa: E731
        m.effects[0].C_d,
        m.effects[1].m_a,
        m.pressure_law.k,
        m.robot.K_Q,
    )

    def thrust(parameters):
        series, _ = run(eqx.tree_at(where, base, tuple(parameters)))
        return jnp.mean(series[-STEPS:, 0])

    at = jnp.stack(where(base))
    plain, forward = jax.jit(thrust), jax.jit(jax.jacfwd(thrust))
    jax.block_until_ready((plain(at), forward(at)))
    ratios = [
        least_cpu_seconds(lambda: forward(at), 2) / least_cpu_seconds(lambda: plain(at), 2)
        for _ in range(repeats)
    ]
    return sorted(ratios)[len(ratios) // 2]


def reverse_gradient(repeats: int) -> dict:
    """Returns cost and memory of the thrust's derivatives with respect to all numbers of the model.

    `ratio` is their cost divided by the cost of the thrust. The memory is the increase from
    `STRIDES` to twice as many strides, divided by the number of additional time steps.
    """
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    from cases import NODES, STEPS, STRIDES, model, run

    one = model()
    numbers = sum(x.size for x in jax.tree.leaves(eqx.filter(one, eqx.is_inexact_array)))

    def thrust(model, strides=STRIDES):
        series, _ = run(model, NODES, STEPS, strides, checkpoint=True)
        return jnp.mean(series[-STEPS:, 0])

    def reverse_over(strides):
        return jax.jit(lambda m: eqx.filter_grad(thrust)(m, strides))

    def memory(strides):
        compiled = reverse_over(strides).lower(one).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    plain, reverse = jax.jit(thrust), reverse_over(STRIDES)
    jax.block_until_ready((plain(one), reverse(one)))
    ratios = [
        least_cpu_seconds(lambda: reverse(one), 2) / least_cpu_seconds(lambda: plain(one), 2)
        for _ in range(repeats)
    ]
    more = STRIDES * STEPS
    return {
        "numbers": numbers,
        "ratio": sorted(ratios)[len(ratios) // 2],
        "bytes_per_step": (memory(2 * STRIDES) - memory(STRIDES)) / more,
    }


def without_library(repeats: int) -> dict:
    """Returns the costs of one robot and of a batch without the compiled solver."""
    import jax

    from slider_jax.dynamics import block_kernel

    used, block_kernel.is_used = block_kernel.is_used, lambda: False
    jax.clear_caches()  # of programs with the library
    try:
        return {"one": single_cost(repeats), "batch_of_112": batch_cost(112, repeats)}
    finally:
        block_kernel.is_used = used
        jax.clear_caches()


def first_calls() -> dict:
    """Returns the wall time [s] of import, compilation and run, without and with a cache."""
    with tempfile.TemporaryDirectory() as cache:
        script = FIRST_CALL.format(here=str(HERE), cache=cache)
        seconds = [
            float(
                subprocess.run(
                    [sys.executable, "-c", script], capture_output=True, text=True, check=True
                ).stdout
            )
            for _ in range(2)
        ]
    return {"cold_s": seconds[0], "cached_s": seconds[1]}


def peer(python: str) -> dict:
    """Returns PyElastica's costs for the same rods, in the same run and on the same core."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "peer.json"
        script = [python, str(HERE / "peer_pyelastica.py"), "--out", str(out)]
        subprocess.run(script, check=True, stdout=subprocess.DEVNULL)
        found = json.loads(out.read_text())
    return {
        "version": found["versions"]["pyelastica"],
        "one": found["robot"]["single_core_s_per_sim_s"],
        "batch_of_112": found["robot"]["batch"]["112"],
        "sheet": found["sheet"]["single_core_s_per_sim_s"],
    }


def batch_memory(members: int) -> float:
    """Returns the memory [MB] of a batch's program: arguments, results and temporary arrays."""
    call, amplitudes = batch_of(members)
    sizes = call.lower(amplitudes).compile().memory_analysis()
    return 1e-6 * (
        sizes.argument_size_in_bytes + sizes.output_size_in_bytes + sizes.temp_size_in_bytes
    )


def growth(repeats: int) -> dict:
    """Returns the cost for several numbers of nodes (one robot), and of robots in a batch."""
    counts = (1, 2, 4, 8, 16, 56, 112, 224, 448, 1024, 4096)
    return {
        "nodes": {n: single_cost(repeats, n) for n in (26, 51, 101, 201, 401)},
        "members": {b: batch_cost(b, repeats if b < 1000 else 2) for b in counts},
        "memory_MB": {b: batch_memory(b) for b in counts},
    }


def plot_growth(table: dict, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    n, cost = zip(*table["nodes"].items(), strict=True)
    left.plot(n, cost, "o-")
    left.set(xlabel="nodes (-)", title="one robot", xticks=n, xlim=(0, None), ylim=(0, None))
    left.set_ylabel("core-seconds per simulated second (-)")
    left.set_xticklabels([str(x) if x > 50 else "" for x in n])
    members, share = zip(*table["members"].items(), strict=True)
    right.semilogx(members, share, "o-", base=2)
    right.set(xlabel="robots (-)", ylabel="core-seconds per\nsimulated second and robot (-)")
    right.set(title="batch")
    ticks = [4**i for i in range(7)]
    right.set(xticks=ticks, xticklabels=ticks, ylim=(0, None))
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--peer-python", help="Python interpreter with pyelastica (default: omit PyElastica)")
    add("--out", type=Path, default=Path("speed.json"), help="results file (default: speed.json)")
    add("--repeats", type=int, default=5, help="number of repeats of each timing (default: 5)")
    add("--growth", action="store_true", help="also measure cost and memory of other sizes")
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    report: dict = {}
    report["first_call"] = first_calls()
    sys.path.insert(0, str(HERE))
    from cases import SHEET

    report["accuracy"] = {"robot": accuracy(), "sheet tail": accuracy(**SHEET)}
    report["batch_of_112"] = batch_cost(112, options.repeats)
    report["one"] = {"timed": single_cost(options.repeats), "51 nodes": single_cost(5, 51)}
    report["one_with_sheet_tail"] = single_cost(options.repeats, **SHEET)
    report["gradient_ratio"] = gradient_ratio(options.repeats)
    report["reverse_gradient"] = reverse_gradient(options.repeats)
    report["without_library"] = without_library(options.repeats)
    if options.peer_python:
        other = report["pyelastica"] = peer(options.peer_python)
        report["times_faster"] = {
            "one": other["one"] / report["one"]["timed"],
            "batch_of_112": other["batch_of_112"] / report["batch_of_112"],
            "sheet": other["sheet"] / report["one_with_sheet_tail"],
        }
    if options.growth:
        report["growth"] = growth(options.repeats)
        plot_growth(report["growth"], options.out.with_suffix(".png"))
    from record import write_record

    write_record(
        options.out, report, "Each cost is the smallest value of the repetitions on one core."
    )
    print(json.dumps(report, indent=1, default=float))


if __name__ == "__main__":
    main()
