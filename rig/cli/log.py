"""`slider rig log`: records pressure logs of a manifold with the authors' published firmware."""

import sys
from functools import partial
from io import RawIOBase

import tyro

from rig.cli.shared import Port
from slider_jax.cli.options import Folder, Frequencies
from slider_jax.errors import InputError


def rig_log(frequencies: tyro.conf.Positional[Frequencies], port: Port, out: Folder) -> None:
    """Runs the sine test of the published Teensy firmware at each frequency, and records the logs.

    This firmware has no stop command and no watchdog. To end a running test, close the supply valve
    by hand. The command writes the firmware's unchanged output to DIR/<frequency>.txt, for `slider
    calibrate manifold` and `slider close-loop`. The output of an interrupted test is in
    DIR/<frequency>.unfinished. The command does not repeat a test whose log exists.

    Args:
        frequencies: frequencies of the commanded sine, in Hz, 0.1 to 5.
        port: serial port of the manifold; `slider rig ports` lists all serial ports.
        out: folder for the logs; created if missing.
    """
    from rig.manifold.published import FREQUENCIES, PublishedManifold
    from rig.manifold.serial_port import open_port
    from slider_jax.io.files import output_folder

    low, high = FREQUENCIES
    if not frequencies:
        raise InputError(f"frequencies: missing; give one or more from {low:g} to {high:g} Hz")
    for frequency in frequencies:
        if not low <= frequency <= high:
            raise InputError.value("frequencies", f"{frequency:g}", f"{low:g} to {high:g} Hz")
    folder = output_folder(out)
    print("this firmware has no stop command: be ready to close the supply valve", file=sys.stderr)
    for frequency in frequencies:
        path = folder / f"{frequency:g}.txt"
        if path.exists():
            print(f"{path.name} exists already")
            continue
        print(f"{frequency:g} Hz ...", file=sys.stderr, flush=True)
        begun = path.with_suffix(".unfinished")
        # The file is unbuffered, so that no received byte is lost if the program is killed.
        with begun.open("wb", buffering=0) as file:
            outcome = PublishedManifold(open_port(port)).run_test(
                frequency, sink=partial(_keep, file)
            )
        begun.replace(path)
        findings = "; ".join(outcome.findings) or "no findings"
        print(f"{path.name}  {outcome.rows} rows: {findings}")


def _keep(file: RawIOBase, host_ns: int, piece: bytes) -> None:
    file.write(piece)
