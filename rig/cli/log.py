"""`slider rig log`: pressure logs of a manifold with the authors' published firmware."""

import sys
from functools import partial
from io import RawIOBase

import tyro

from rig.cli.shared import Port
from slider_jax.cli.options import Folder, Frequencies
from slider_jax.errors import InputError


def rig_log(
    frequencies: tyro.conf.Positional[Frequencies],
    port: Port,
    out: Folder,
) -> None:
    """Run the published Teensy firmware's own sine test at each frequency, and keep its logs.

    DIR/<frequency>.txt is what it wrote, byte for byte, as `slider calibrate manifold` and `slider
    close-loop` read it; what a test that broke off left is in <frequency>.unfinished. This firmware
    has no stop and no watchdog: once a test has begun only the supply's valve ends it. Logs that
    are there are not taken again.

    Args:
        frequencies: of the commanded sine [Hz].
        port: serial port of the manifold.
        out: folder for the logs; made if missing.
    """
    from rig.manifold.published import FREQUENCIES, PublishedManifold
    from rig.manifold.serial_port import open_port
    from slider_jax.io.files import output_folder

    low, high = FREQUENCIES
    if not frequencies:
        raise InputError(f"frequencies: given nothing; allowed {low:g} to {high:g} Hz")
    for frequency in frequencies:
        if not low <= frequency <= high:
            raise InputError.value("frequencies", f"{frequency:g}", f"{low:g} to {high:g} Hz")
    folder = output_folder(out)
    print("this firmware has no stop: keep a hand at the supply's valve", file=sys.stderr)
    for frequency in frequencies:
        path = folder / f"{frequency:g}.txt"
        if path.exists():
            print(f"{path.name} is there already")
            continue
        print(f"{frequency:g} Hz ...", file=sys.stderr, flush=True)
        begun = path.with_suffix(".unfinished")
        # Unbuffered: what came is on disk, whatever ends this program.
        with begun.open("wb", buffering=0) as file:
            outcome = PublishedManifold(open_port(port)).run(frequency, sink=partial(_keep, file))
        begun.replace(path)
        said = "; ".join(outcome.findings) or "no findings"
        print(f"{path.name}  {outcome.rows} rows: {said}")


def _keep(file: RawIOBase, host_ns: int, piece: bytes) -> None:
    file.write(piece)
