"""Makes the page on performance from the records of the benchmarks.

    python docs/generate/performance.py

The text is in performance.md.j2, next to this script. The figures are in benchmarks/results, one
file for each benchmark, with the commit, the date and the machine of the measurement.
"""

import json
from pathlib import Path
from statistics import median
from textwrap import fill
from typing import Any

from jinja2 import Environment, StrictUndefined

ROOT = Path(__file__).resolve().parents[2]
PAGE, TEMPLATE = ROOT / "docs" / "reference" / "performance.md", "performance.md.j2"
NAMES = (
    "speed", "speed_avx2", "start_up", "sharing", "population", "space", "close_loop_time",
    "close_loop_long",
)  # fmt: skip
FIRST_RUN = "first run"
"""Name of the run of `slider close-loop` that also compiles the programs."""
TANKS = {
    "none": "none",
    "leakage": "leakage",
    "tail_stiffness": "stiffer tail",
    "force_drift": "drift of the force sensor, below its detection limit",
    "clamp_compliance": "compliant clamp",
    "tank_current": "current",
    "line_lag": "lag of the line",
    "tail_drag": "drag of the tail",
    "regulator_gain": "gain of the regulator",
    "valve_delay_and_friction": "dead time of the valves, and weak skin friction",
}
"""Missing effects of the tanks of close_loop_time.py."""
MACHINES = ((1, 12_800, 16), (10, 12_800, 16), (100, 12_800, 16), (100, 112_000, 16))
"""Processes, individuals and cores for each process in the model of the exchange."""


def records() -> dict[str, dict[str, Any]]:
    """Returns the records by name. Each record states what its figures depend on."""
    folder = ROOT / "benchmarks" / "results"
    return {name: json.loads((folder / f"{name}.json").read_text("utf-8")) for name in NAMES}


def table(head: list[str], rows: list[list[Any]]) -> str:
    return "\n".join(
        f"| {' | '.join(map(str, line))} |" for line in [head, ["---"] * len(head), *rows]
    )


def origin_of(record: dict[str, Any], what: str) -> str:
    """Returns the sentences on the command, the commit, the date and the machine of a record.

    `what` names the figures of the record, as a part of the first sentence.
    """
    machine, load = record["machine"], record["machine"]["load"]
    busy = f", load {load[0]} at the end" if load else ""
    return (
        f"`{record['command']}` measured {what} at commit {record['commit']} ({record['date']}) on "
        f"{machine['processor']}, {machine['cores']} cores ({machine['system']}{busy}). "
        f"{record['note']}".rstrip()
    )


def percent(x: float) -> str:
    return f"{100.0 * x:.2g} %"


def number(x: float) -> str:
    return f"{x:.2g}" if abs(x) < 100.0 else f"{x:.0f}"


def growth(first: str, rows: dict[str, dict[str, float]]) -> str:
    """Returns a table with a column for each size and a row for each quantity."""
    sizes = next(iter(rows.values()))
    return table(
        [first, *sizes], [[name, *map(number, values.values())] for name, values in rows.items()]
    )


def costs(speed: dict[str, Any]) -> str:
    peer, ratio = speed["pyelastica"], speed["times_faster"]
    sheet = "one robot whose tail is a sheet, 0.93 mm thick, with Young's modulus 2.9 GPa"
    unit = "(CPU s per simulated s)"
    head = ["case", f"this simulator {unit}", f"PyElastica {peer['version']} {unit}", "ratio"]
    one, batch = speed["one"], speed["batch_of_112"]
    cases = (
        ("one robot with 31 nodes, after compilation", one["timed"], "one"),
        ("batch of 112 robots, per robot", batch, "batch_of_112"),
        (sheet, speed["one_with_sheet_tail"], "sheet"),
    )
    rows = [[name, *map(number, (x, peer[key], ratio[key]))] for name, x, key in cases]
    second = ["one robot with 51 nodes, after compilation", number(one["51 nodes"])]
    return table(head, [rows[0], [*second, "not measured", ""], *rows[1:]])


def other_costs(speed: dict[str, Any]) -> str:
    forward = (
        "computing time of the thrust and its forward derivatives (with respect to C_d, m_a, k and "
        "K_Q), divided by the computing time of the thrust alone"
    )
    reverse = speed["reverse_gradient"]
    backward = (
        f"the same for reverse-mode derivatives with respect to all {reverse['numbers']} numbers "
        "of the model, which compute each step twice"
    )
    call, first = "wall-clock time of the first call", speed["first_call"]
    return table(["other costs of this simulator", "value"], [
        [forward, number(speed["gradient_ratio"])],
        [backward, number(reverse["ratio"])],
        ["memory of these reverse-mode derivatives for each time step",
         f"{1e-3 * reverse['bytes_per_step']:.1f} kB"],
        [f"{call} with import, compilation and run", f"{first['cold_s']:.1f} s"],
        [f"{call} in a second process, with cached compiled programs",
         f"{first['cached_s']:.1f} s"],
    ])  # fmt: skip


def first_calls(figures: dict[str, Any]) -> str:
    """Returns the table of first calls: wall-clock time, and CPU time in brackets."""

    def time(x: dict[str, float] | None) -> str:
        return f"{x['wall_s']:.1f} s ({x['cpu_s']:.1f} s)" if x else ""

    head = ["process", "first process", "second process", "first process after warm-up"]
    one = figures["one_simulation"]
    rows = [["one simulation of the benchmark's robot", time(one["cold"]), time(one["second"]), ""]]
    for name, x in figures["calls"].items():
        rows.append(
            [f"`slider {name}`", *(time(x.get(k)) for k in ("cold", "second", "after_warm_up"))]
        )
    rows += [
        ["`slider --help`", f"{figures['help']['wall_s']} s", "", ""],
        ["`slider warm-up`", time(figures["warm_up"]), time(figures["warm_up_again"]), ""],
        ["`slider warm-up --parts close-loop`", time(figures["warm_up_of_close_loop"]), "", ""],
    ]
    return table(head, rows)


def sharing_table(figures: dict[str, Any]) -> str:
    head = [
        "population",
        "processes",
        "files",
        "bytes of a file",
        "computing (s)",
        "generation (s)",
    ]
    return table(head, [
        [name, processes, f"{x['files']:.0f}", x["bytes_of_file"], f"{x['computing_s']:.2f}",
         f"{x['generation_s']:.2f}"]
        for name, cases in figures.items() for processes, x in cases.items()
    ])  # fmt: skip


def model_of_sharing(figures: dict[str, Any]) -> str:
    """Returns the exchange of a generation for several numbers of machines."""
    empty = figures["112 individuals"]["1"]["bytes_of_file"] - 8 * 16
    rows = []
    for machines, individuals, cores in MACHINES:
        parts = -(-individuals // (8 * cores))
        size = empty + 64 * cores
        rows.append([
            machines, individuals, parts, -(-parts // machines), f"{1e-3 * parts * size:.0f} kB",
            f"{1e-6 * machines * parts * size:.2f} MB", machines * parts,
        ])  # fmt: skip
    head = [
        "machines of 16 cores",
        "individuals",
        "result files",
        "parts of each machine",
        "written",
    ]
    return table([*head, "read by all", "files opened by all"], rows)


def rows(head: list[str], figures: dict[str, list[str]]) -> str:
    return table(head, [[name, *values] for name, values in figures.items()])


def of_loop(name: str, x: dict[str, Any]) -> list[str]:
    costs = f"{x['wall_s']:.0f}", f"{x['cpu_s']:.0f}", f"{x['peak_GB']:.2f}"
    return [name, f"`{x['verdict']}`", *costs]


def loop_times(runs: dict[str, dict[str, Any]]) -> str:
    """Returns the table of the tanks, from the fastest to the slowest."""
    head = ["missing effect", "verdict", "wall-clock time (s)", "CPU time (s)", "peak memory (GB)"]
    tanks = sorted((x["wall_s"], name) for name, x in runs.items() if name != FIRST_RUN)
    return table(head, [of_loop(TANKS[name], runs[name]) for _, name in tanks])


def median_time(runs: dict[str, dict[str, Any]]) -> str:
    return f"{median(x['wall_s'] for name, x in runs.items() if name != FIRST_RUN):.0f} s"


def long_times(trials: dict[str, dict[str, Any]]) -> str:
    head = ["trials", "samples (s)", "CPU time (s)", "peak memory (GB)", "verdict"]
    return table(head, [
        [name, x["samples_s"], x["cpu_s"], x["peak_GB"], x["verdict"]] for name, x in trials.items()
    ])  # fmt: skip


def render(found: dict[str, dict[str, Any]]) -> str:
    """Returns the text of the page, given the records by name."""
    used: set[str] = set()

    def origin(name: str, what: str = "the figures of this section") -> str:
        used.add(name)
        return origin_of(found[name], what)

    functions = (
        percent, number, growth, costs, other_costs, first_calls, sharing_table, model_of_sharing,
        rows, loop_times, median_time, long_times,
    )  # fmt: skip
    environment = Environment(undefined=StrictUndefined, keep_trailing_newline=True)
    template = environment.from_string((Path(__file__).parent / TEMPLATE).read_text("utf-8"))
    text = template.render(
        {f.__name__: f for f in functions},
        origin=origin,
        records=found,
        **{name: record["figures"] for name, record in found.items()},
    )
    assert used == set(found), f"records without their commit on the page: {set(found) - used}"
    return "\n\n".join(map(filled, text.rstrip("\n").split("\n\n"))) + "\n"


def filled(block: str) -> str:
    """Returns a paragraph in lines of at most 120 characters; other blocks stay unchanged."""
    if block.startswith(("#", "|", "!", "```")):
        return block
    return fill(block, 120, break_long_words=False, break_on_hyphens=False)


def main() -> None:
    PAGE.write_text(render(records()), encoding="utf-8")


if __name__ == "__main__":
    main()
