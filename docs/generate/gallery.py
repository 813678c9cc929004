"""Writes the gallery page: the output and a picture of each command, from runs on small meshes.

    python docs/generate/gallery.py --work DIR [COMMAND ...]    # such as swim "rig check"

Without a COMMAND, the script runs all commands, which takes an hour on two cores. It writes inputs
and results to DIR. A later run uses the inputs and results that are already in DIR. The lamprey's
midlines and the pressure logs of the rig are measured data. `SLIDER_DATA` names their folder.
"""

import argparse
import base64
import contextlib
import io
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import wrap
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
PAGE, PICTURES = ROOT / "docs" / "gallery.md", ROOT / "docs" / "img" / "gallery"
LARGEST_PICTURE = 100_000
"""Largest size of a picture file [bytes], so that the repository stays small."""
WIDEST = 900
"""Largest width of a picture [pixels]: about the width of the site's text."""
LONGEST = 24
"""Largest number of lines of a transcript; "..." replaces the other lines."""
COLUMNS = 110
"""Largest number of characters in a line of a transcript."""
PORT = "/dev/pts/3"
"""Port in the text of the page; it replaces the simulated rig's actual port."""


INTERRUPTIBLE = """
import signal, sys
from slider_jax.cli.main import main
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(main(sys.argv[1:]))
"""
"""Program that runs a command and stops it at SIGINT, which children of background jobs ignore."""


class Entry(NamedTuple):
    """A command of the gallery."""

    line: str
    """The command line, without `slider`."""
    text: str
    """Sentences on what the picture or the transcript shows."""
    picture: str = ""
    """Picture that the run writes, or `report.html#N` for picture N of the report; may be empty."""
    needs: str = ""
    """Name of the function in `INPUTS` that makes the input, or of a simulated rig."""
    more: str = ""
    """Sentence with a link to a larger run."""


ENTRIES = {
    "demo": Entry(
        "demo",
        "The picture shows the mean thrust against the stride frequency, and the paper's values.",
        "slider_demo/thrust_against_frequency.png",
    ),
    "simulate": Entry(
        "simulate docs/experiment.toml --out results/example --plot --shape",
        "The picture shows pressures, thrust, recoil and tip position of the second trial, in "
        "which the robot is towed.",
        "results/example/towed.png",
    ),
    "export": Entry(
        "export results/example/towed_shape.npz --every 20 --out results/example/vtk",
        "The input is a file of `slider simulate --shape`. ParaView opens the written "
        "`towed_shape.pvd`.",
        more="[Simulating in three dimensions](how-to/three_dimensions.md#the-shape-as-data) "
        "describes the files.",
    ),
    "statics": Entry(
        "statics examples/strip/rod.toml --out results/strip",
        "The picture shows a strip under water, without and with its loads: weight, a helical air "
        "chamber and a tendon.",
        "results/strip/shape.png",
        needs="examples",
    ),
    "warm-up": Entry(
        "warm-up docs/experiment.toml --parts simulate swim",
        "The command compiled the programs of two commands for this experiment on a new computer. "
        "The next `slider simulate` and `slider swim` load them.",
    ),
    "sweep": Entry(
        "sweep docs/experiment.toml --field robot.EI_tail --from 0.002 --to 0.02 --count 8 "
        "--strides 5 --steps-per-stride 100 --out results/tail",
        "The picture shows means over the steady strides against the tail's bending stiffness.",
        "results/tail/sweep.png",
    ),
    "swim": Entry(
        "swim docs/swimmer.toml --out results/swim",
        "The picture shows the midlines of one steady stride. It also shows the speed from rest, "
        "with and without the drag of the head.",
        "results/swim/swim_swim.png",
    ),
    "climb": Entry(
        "climb --out results/climb",
        "The picture shows one steady stride on the wall, and the rise of the robot over the last "
        "strides.",
        "results/climb/climb_climb.png",
    ),
    "transition": Entry(
        "transition --out results/transition",
        "The picture shows the robot's way from the water to the wall, and its height, wet part "
        "and energies against time.",
        "results/transition/transition.png",
    ),
    "optimize swim": Entry(
        "optimize swim --population 16 --generations 5 --steps-per-stride 48 --out results/optimum",
        "The picture shows the swimming speed against the number of evaluations. For a real "
        "search, use the default population and number of generations.",
        "results/optimum/optimum.png",
    ),
    "optimize multimodal": Entry(
        "optimize multimodal --betas 3 --population 8 --generations 3 --steps-per-stride 48 "
        "--out results/multimodal",
        "The picture shows the best tail and the best drives for each weight beta, from climbing "
        "alone (beta = 0) to swimming alone (beta = 1). For a real search, use the defaults.",
        "results/multimodal/multimodal.png",
        more="[Climbing](how-to/climbing.md#one-tail-for-both-tasks) describes a complete search.",
    ),
    "optimize transition": Entry(
        "optimize transition --population 4 --generations 2 --out results/crossing",
        "The picture shows the mean speeds of swimming alone, climbing alone and the whole way "
        "against the number of evaluations. For a real search, use the defaults.",
        "results/crossing/optimum.png",
        more="[From the water to the wall](how-to/transition.md#optimising) describes a complete "
        "search.",
    ),
    "effects": Entry(
        "effects valve_delay --out results/effects",
        "The picture shows how a dead time of the valves changes each sensor's reading in one "
        "steady stride.",
        "results/effects/valve_delay.png",
    ),
    "effects matrix": Entry(
        "effects matrix tank/experiment.toml --only valve_delay line_lag leakage "
        "regulator_gain pressure_gain tail_stiffness --out results/matrix",
        "The picture shows the similarity of six effects and their detection limits. Dots mark "
        "pairs of effects between which the trials cannot discriminate.",
        "results/matrix/matrix.png",
        "tank",
    ),
    "calibrate": Entry(
        "calibrate tank/experiment.toml --out results/calibrated",
        "The output lists the four base parameters with 95 % intervals. The valves of the "
        "simulated tank have a dead time of 20 ms, which the model does not contain.",
        needs="tank",
    ),
    "calibrate statics": Entry(
        "calibrate statics bench/bench.toml --out results/bench",
        "The picture shows the displacements under tip loads, and the fitted shapes.",
        "results/bench/whole.png",
        "bench",
    ),
    "calibrate manifold": Entry(
        "calibrate manifold logs/*.txt --out results/manifold",
        "The picture shows a measured log and the fitted first-order lag.",
        "results/manifold/1.1667.png",
        "logs",
    ),
    "close-loop": Entry(
        "close-loop tank/experiment.toml --out results/tank",
        "The measured trials are those of the section on `slider calibrate`. The command "
        "finds the dead time of 20 ms. The picture is from `report.html`.",
        "results/tank/report.html#0",
        "tank",
        "[How well the loop finds missing effects](explanation/how_well_it_traces.md) shows the "
        "results for many tanks.",
    ),
    "lamprey": Entry(
        "lamprey midlines --draws 40 --out results/lamprey",
        "The picture shows midlines of a lamprey (E. D. Tytell, fishmechr, CC-BY-4.0) in one "
        "stride, and the depth and width of its body. The output lists the axial force balance.",
        "results/lamprey/report.html#0",
        "midlines",
    ),
    "published": Entry(
        "published --out results/published",
        "The picture shows the published speeds (dotted lines), and the simulated speed of a "
        "robot that starts at rest.",
        "results/published/report.html#0",
    ),
    "rig simulate": Entry(
        "rig simulate docs/experiment.toml", "The simulated rig runs until Ctrl-C.", needs="rig"
    ),
    "rig ports": Entry("rig ports", "Each line of the output shows one port."),
    "rig check": Entry(
        f"rig check --port {PORT} --rig simulated_rig.toml",
        "The output shows the data rate, the noise and the leak test of the simulated rig.",
        needs="bench rig",
    ),
    "rig run": Entry(
        f"rig run docs/experiment.toml --port {PORT} --rig simulated_rig.toml --out measured",
        "This run records two trials on the simulated rig.",
        needs="bench rig",
    ),
    "rig replay": Entry(
        "rig replay measured --out again",
        "This run computes the CSV files again from the recordings of the previous command.",
    ),
    "rig watch": Entry(
        f"rig watch docs/experiment.toml --port {PORT} --rig simulated_rig.toml --seconds 35",
        "This run watches the simulated rig for 35 s.",
        needs="rig",
    ),
    "rig log": Entry(
        f"rig log 1 2 --port {PORT} --out new_logs",
        "This run records two pressure logs of a simulated manifold with the published firmware.",
        needs="published rig",
    ),
    "rig loop": Entry(
        f"rig loop three_trials.toml --port {PORT} --rig simulated_rig.toml --budget 3 "
        "--out results/loop",
        "In this run, the rig measures the three trials of the file. With a larger budget, the "
        "command adds trials.",
        needs="rig",
        more="[How well the loop finds missing effects]"
        "(explanation/how_well_it_traces.md#on-a-simulated-rig) describes a complete run.",
    ),
}
"""The commands in the order of the page."""


def _data(name: str) -> Path:
    from tests.support.data import data_dir

    folder = data_dir()
    if folder is None:
        raise SystemExit(f"SLIDER_DATA: no folder {name}; set it to the folder of measured data")
    return folder / name


def _link(work: Path, name: str, target: Path) -> None:
    if not (work / name).exists():
        (work / name).symlink_to(target)


def make_tank(work: Path) -> None:
    """Writes a tank experiment whose valves have a dead time of 20 ms."""
    from calibration.measurements.synthetic import (
        Truth,
        random_base_parameters,
        random_trials,
        write_tank,
    )
    from slider_jax.precision import enable_float64

    import numpy as np  # isort: skip

    enable_float64()
    truth = Truth(
        random_base_parameters(np.random.default_rng(0)), {"valve_delay": {"delay": 0.02}}
    )
    if not (work / "tank").exists():
        write_tank(work / "tank", truth, random_trials(0, 5, 0.5), 0)


def make_bench(work: Path) -> None:
    """Writes a bench from the formulas for small deflections, with EI 0.042 and 0.005 N m^2."""
    import numpy as np

    folder, L, tail, EI, EI_tail, K_Q = work / "bench", 0.368, 0.07, 0.042, 0.005, 4.3e-7
    folder.mkdir(exist_ok=True)
    rng, noise = np.random.default_rng(0), 1e-4
    force, pressure = np.linspace(0.005, 0.05, 8), np.linspace(5e3, 3e4, 8)
    softness = (L**3 - tail**3) / (3.0 * EI) + tail**3 / (3.0 * EI_tail)
    arm = 0.125 * (L - 0.5 * (0.02 + 0.145))
    tables = {
        "whole": ("force_N,tip_m", [force], force * softness),
        "tail": ("force_N,tip_m", [4 * force], 4 * force * tail**3 / (3.0 * EI_tail)),
        "pressure": (
            "p_front_Pa,p_rear_Pa,tip_m",
            [pressure, 0 * pressure],
            K_Q * pressure / EI * arm,
        ),
    }
    for name, (header, loads, tip) in tables.items():
        rows = np.stack([*loads, tip + noise * rng.normal(size=len(tip))], axis=1)
        np.savetxt(folder / f"{name}.csv", rows, "%.7g", ",", header=header, comments="")
    text = (ROOT / "docs" / "bench.toml").read_text(encoding="utf-8")
    text = text.split("[[ring_down]]")[0].replace("0.0005 ", "0.0001 ")
    (folder / "bench.toml").write_text(text, encoding="utf-8")


@contextlib.contextmanager
def simulated_rig(work: Path, *options: str) -> Iterator[str]:
    """Runs the simulated rig in `work` and yields its first output, with its port."""
    words = [sys.executable, "-c", INTERRUPTIBLE, "rig", "simulate", *options]
    with open(work / "rig.log", "w") as log:
        process = subprocess.Popen(words, cwd=work, stdout=log, stderr=subprocess.STDOUT)
    try:
        for _ in range(240):
            time.sleep(0.5)
            text = (work / "rig.log").read_text()
            if "/dev/" in text and text.endswith("\n"):
                time.sleep(3.0)
                break
        yield (work / "rig.log").read_text()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


def three_trials(work: Path) -> None:
    """Writes an experiment with three trials that differ in frequency."""
    text = (work / "docs" / "experiment.toml").read_text(encoding="utf-8")
    head = text.split("[[trials]]")[0]
    for frequency in (1.0, 2.0, 3.0):
        head += (
            f'[[trials]]\nfile = "trial_{frequency:g}_Hz.csv"\nfrequency = {frequency}\n'
            f"amplitude = 150e3\nphase = 0.15\nduration = {2.0 + 1.0 / frequency:g}\n\n"
        )
    (work / "three_trials.toml").write_text(head, encoding="utf-8")


INPUTS: dict[str, Callable[[Path], None]] = {
    "tank": make_tank,
    "bench": make_bench,
    "logs": lambda work: _link(work, "logs", _data("manifold")),
    "midlines": lambda work: _link(work, "midlines", _data("lamprey")),
    "examples": lambda work: _link(work, "examples", ROOT / "examples"),
}


def transcript(text: str) -> str:
    """Returns the printed lines, wrapped to `COLUMNS` and cut to `LONGEST` lines."""
    lines = []
    for line in text.strip().splitlines():
        indent = " " * (len(line) - len(line.lstrip()) + 4)
        lines += [line] if len(line) <= COLUMNS else wrap(line, COLUMNS, subsequent_indent=indent)
    return "\n".join(lines if len(lines) <= LONGEST else [*lines[: LONGEST - 1], "..."])


def save_picture(source: Path, number: int | None, path: Path) -> None:
    """Writes a picture file, or the report's picture `number`, as a small PNG."""
    from PIL import Image

    content = source.read_bytes()
    if number is not None:
        found = re.findall(rb"data:image/png;base64,([A-Za-z0-9+/=]+)", content)
        content = base64.b64decode(found[number])
    picture = Image.open(io.BytesIO(content)).convert("RGB")
    if picture.width > WIDEST:
        height = round(picture.height * WIDEST / picture.width)
        picture = picture.resize((WIDEST, height), Image.Resampling.LANCZOS)
    for colours in (256, 128, 64, 32):
        picture.quantize(colours).save(path, optimize=True)
        if path.stat().st_size <= LARGEST_PICTURE:
            return
    raise SystemExit(f"{path}: over {LARGEST_PICTURE} bytes; draw a simpler picture")


def run_line(work: Path, line: str, port: str) -> str:
    """Runs a command line in `work` and returns its output."""
    words = []
    for word in shlex.split(line.replace(PORT, port)):
        words += (
            sorted(str(x.relative_to(work)) for x in work.glob(word)) if "*" in word else [word]
        )
    done = subprocess.run(
        [sys.executable, "-m", "slider_jax.cli.main", *words],
        cwd=work,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "100"},
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"slider {line}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return (done.stdout or done.stderr.splitlines()[-1]).replace(port, PORT)


def make_output(name: str, work: Path) -> str:
    """Runs a command and returns its picture and its output as Markdown."""
    entry = ENTRIES[name]
    if entry.needs in INPUTS:
        INPUTS[entry.needs](work)
    if name == "rig simulate":
        with simulated_rig(work, "docs/experiment.toml") as text:
            pass
        text = re.sub(r"/dev/pts/\d+", PORT, text)
    elif "rig" in entry.needs:
        # Only `rig watch` and `rig loop` need the simulated robot, which costs CPU time.
        options = {"bench rig": (), "published rig": ("--published",)}.get(
            entry.needs, ("docs/experiment.toml",)
        )
        with simulated_rig(work, *options) as first:
            port = re.findall(r"/dev/\S+?(?=[\s;,.]|$)", first)[0]
            text = run_line(work, entry.line, port)
    else:
        text = run_line(work, entry.line, PORT)
    parts = []
    if entry.picture:
        source, _, number = entry.picture.partition("#")
        path = PICTURES / f"{name.replace(' ', '_')}.png"
        files = sorted(work.glob(source))
        if not files:
            wrote = [str(x.relative_to(work)) for x in (work / source).parent.glob("*")]
            raise SystemExit(f"{name}: {source} is missing; the folder has {wrote}")
        save_picture(files[0], int(number) if number else None, path)
        parts.append(f"![slider {name}: {entry.text}](img/gallery/{path.name})")
    if text.strip():
        parts.append(f"```text\n{transcript(text)}\n```")
    return "\n\n".join(parts)


def kept_outputs() -> dict[str, str]:
    """Returns the outputs in the page, by command."""
    page = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    found = re.findall(r"<!-- output of slider (.*?) -->\n(.*?)\n<!-- end -->", page, re.DOTALL)
    return dict(found)


def render(outputs: dict[str, str]) -> str:
    """Returns the page, given the output of each command."""
    from slider_jax.cli.commands import COMMANDS

    parts = [
        "# Gallery",
        "This page shows one run of each command. The settings are small enough for a laptop. The "
        "[command-line reference](reference/command_line.md) explains all options. "
        "`docs/generate/gallery.py` writes this page.",
    ]
    for name, entry in ENTRIES.items():
        help_line = COMMANDS[name].help
        parts += [
            f"## slider {name}",
            f"The command {help_line}. {entry.text} {entry.more}".rstrip(),
            f"```sh\nslider {entry.line}\n```",
        ]
        if name in outputs:
            parts.append(f"<!-- output of slider {name} -->\n{outputs[name]}\n<!-- end -->")
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Runs the script."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="commands to run (default: all)")
    parser.add_argument("--work", type=Path, required=True, help="folder for inputs and results")
    asked = parser.parse_args()
    work = asked.work.resolve()
    (work / "docs").mkdir(parents=True, exist_ok=True)
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in ("experiment.toml", "swimmer.toml"):
        text = (ROOT / "docs" / name).read_text(encoding="utf-8")
        text = text.replace("nodes = 51 ", "nodes = 31 ").replace("step = 0.001 ", "step = 0.002 ")
        (work / "docs" / name).write_text(text, encoding="utf-8")
    three_trials(work)
    for name in asked.names or ENTRIES:
        started = time.perf_counter()
        output = make_output(name, work)
        PAGE.write_text(render(kept_outputs() | {name: output}), encoding="utf-8")
        print(f"{name}: {time.perf_counter() - started:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
