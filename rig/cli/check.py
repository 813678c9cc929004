"""`slider rig check`: checks a rig before a trial."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from rig.cli.shared import Port, RigFile
from slider_jax.cli.options import MaybeExperiment, Value
from slider_jax.errors import InputError


def rig_check(
    experiment: MaybeExperiment = None,
    *,
    port: Port,
    rig: RigFile = None,
    pressure: Value = 50e3,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="CHECK.json", help_behavior_hint="(default: no file)")
    ] = None,
) -> int:
    """Checks the force sensor and the manifold: readings, answer times, noise, chamber pressures.

    First, the command checks the force sensor of the rig file for 1 s. Then the command sets one
    chamber after another to the test pressure for 1.5 s. All chambers vent at the end. The exit
    code is 1 if the command finds a problem.

    Args:
        experiment: experiment file of the robot, which names the chambers (default: SLIDER).
        port: serial port of the manifold; `slider rig ports` lists all serial ports.
        rig: TOML file of the rig.
        pressure: set pressure of the test, in Pa.
        out: JSON file for the results. The file's folder is created if missing.
    """
    from rig.cli.settings import load_rig
    from rig.cli.shared import layout_in, open_force_sensor, signals_as_ctrl_c
    from rig.force.sensor import SensorMounting
    from rig.manifold.driver import Manifold
    from rig.manifold.limits import PressureLimits
    from rig.manifold.serial_port import open_port
    from rig.protocol.messages import channel_names
    from rig.scheduling import real_time_priority
    from rig.trial.health_check import ReadingCollector, check_force, check_manifold
    from slider_jax.io.files import output_folder, write_json

    if not pressure >= 1e3:
        raise InputError.value(
            "--pressure", f"{pressure:g}", "1000 Pa or more", "give pascal, not kPa or psi"
        )
    if out is not None:
        if out.is_dir():
            raise InputError(f"--out {out}: is a folder; give a file, such as {out / 'check.json'}")
        output_folder(out.parent)
    settings = load_rig(rig)
    layout = layout_in(experiment)
    limits = PressureLimits.of(settings.manifold.limits, layout, f"{rig}: manifold.limits")
    limits.checked([pressure] * len(layout.names))
    forces = None
    if settings.force is not None:
        print("force sensor ...", file=sys.stderr)
        with (
            signals_as_ctrl_c(),
            real_time_priority(),
            open_force_sensor(settings.force)[0] as source,
        ):
            mounting = SensorMounting(settings.force.thrust, settings.force.recoil)
            forces = check_force(source, mounting)
    collector = ReadingCollector()
    with (
        signals_as_ctrl_c(),
        real_time_priority(),
        Manifold(open_port(port), on_reading=collector) as manifold,
    ):
        manifold.configure(limits)
        ident = manifold.ident
        found = check_manifold(
            manifold, collector, pressure, lambda text: print(f"{text} ...", file=sys.stderr)
        )
    assert ident is not None
    trip = 1e3 * found.round_trip
    print(f"firmware {ident.major}.{ident.minor}.{ident.patch}, protocol {ident.protocol}")
    print(f"{found.rate:.0f} readings/s, {found.lost} lost; {found.damaged} damaged frames")
    if len(trip):
        median = sorted(trip)[len(trip) // 2]
        print(f"answer time to a command: median {median:.1f} ms, maximum {trip.max():.1f} ms")
    for name, offset, noise in zip(
        channel_names(layout.names), found.offset, found.noise, strict=True
    ):
        print(f"{name:<20} at rest {offset:10.1f}, noise {noise:8.2f}")
    for x in found.held:
        print(
            f"{x.name:<12} reached {1e-3 * x.reached:7.2f} of {1e-3 * x.asked:g} kPa, "
            f"63 % of the reached pressure after {1e3 * x.rise:.0f} ms"
        )
    findings, content = list(found.findings), found._asdict()
    content["held"] = [x._asdict() for x in found.held]
    if forces is not None:
        print(f"force sensor: {forces.rate:.0f} records/s, {forces.lost} lost")
        for i, name in enumerate(("thrust_N", "recoil_N")):
            print(f"{name:<20} at rest {forces.offset[i]:10.4f}, noise {forces.noise[i]:8.4f}")
        findings += forces.findings
        content["force"] = forces._asdict()
    print("\n".join(findings) or "no findings")
    if out is not None:
        write_json(out, content | {"findings": findings})
    return 1 if findings else 0
