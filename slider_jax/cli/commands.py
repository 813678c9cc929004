"""The table of subcommands. It lists functions as text, so that only the called one is imported."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple


class Subcommand(NamedTuple):
    """A subcommand: its `module:function`, imported only when it runs, and its line of help.

    tyro builds the command line from the function's signature. It returns None or an exit code.
    """

    target: str
    help: str
    alone: bool = False
    """Whether the command has the name of a group and may run without arguments."""
    jax: bool = True
    """Whether the command needs JAX, which may not be installed on the rig's computer."""


COMMANDS = {
    "simulate": Subcommand(
        "slider_jax.cli.simulate:simulate",
        "simulates an experiment's trials, or the thrust of a pressure log",
    ),
    "demo": Subcommand(
        "slider_jax.cli.demo:demo", "simulates the paper's frequency sweep; needs no input"
    ),
    "sweep": Subcommand(
        "slider_jax.cli.sweep:sweep", "varies one or two fields of an experiment over ranges"
    ),
    "swim": Subcommand(
        "slider_jax.cli.swim:swim", "simulates free swimming and computes the steady speed"
    ),
    "climb": Subcommand("slider_jax.cli.swim:climb", "simulates climbing in air, pinned to a wall"),
    "optimize swim": Subcommand(
        "slider_jax.cli.optimize:optimize_swim", "optimises tail and gait for the fastest swimming"
    ),
    "optimize multimodal": Subcommand(
        "slider_jax.cli.optimize:optimize_multimodal",
        "optimises one tail for both swimming and climbing",
    ),
    "close-loop": Subcommand(
        "calibration.cli.close_loop:close_loop",
        "finds the effects that a model lacks, from measured trials",
    ),
    "lamprey": Subcommand(
        "calibration.cli.lamprey:lamprey",
        "computes a swimming animal's axial force balance from its midlines",
    ),
    "published": Subcommand(
        "calibration.cli.published:published",
        "compares the paper's swimming speeds with its equations",
    ),
    "effects matrix": Subcommand(
        "calibration.cli.effects_matrix:effects_matrix",
        "computes which effects an experiment can detect and discriminate between",
    ),
    "effects": Subcommand(
        "slider_jax.cli.effects:list_effects",
        "lists the effects that a model may lack and how sensors show them",
        alone=True,
    ),
    "calibrate manifold": Subcommand(
        "calibration.cli.calibrate:manifold", "fits the pressure lag to the rig's own logs"
    ),
    "calibrate statics": Subcommand(
        "calibration.cli.calibrate_statics:statics",
        "fits EI, damping and K_Q to bench tests in air",
    ),
    "calibrate": Subcommand(
        "calibration.cli.calibrate_tank:tank", "fits C_d, m_a, k and K_Q to measured trials"
    ),
    "rig ports": Subcommand(
        "rig.cli.shared:rig_ports", "lists this computer's serial ports", jax=False
    ),
    "rig check": Subcommand(
        "rig.cli.check:rig_check",
        "checks a rig's serial line, noise and leaks in a minute",
        jax=False,
    ),
    "rig run": Subcommand(
        "rig.cli.run:rig_run", "runs and records an experiment's trials on the rig", jax=False
    ),
    "rig log": Subcommand(
        "rig.cli.log:rig_log", "records pressure logs of the published firmware", jax=False
    ),
    "rig replay": Subcommand(
        "rig.cli.replay:rig_replay", "recomputes a recording's columns, or plays it back", jax=False
    ),
    "rig watch": Subcommand(
        "rig.cli.watch:rig_watch",
        "runs the calibrated model in parallel with the rig and raises alarms",
    ),
    "rig loop": Subcommand(
        "rig.cli.loop:rig_loop", "measures trials and closes the loop until the class is final"
    ),
    "rig simulate": Subcommand(
        "rig.cli.simulate:rig_simulate",
        "simulates a rig, to try the commands without hardware",
        jax=False,
    ),
}

SIMULATE_LOG = "calibration.cli.simulate_log:simulate_log"
"""The function that `slider simulate` calls for a pressure log."""


def function_of(target: str) -> Callable[..., Any]:
    """Imports the module of a `module:function` and returns the function."""
    module, function = target.split(":")
    return getattr(import_module(module), function)


def rig_error() -> type[Exception]:
    """Returns the exception class that the rig's commands raise for invalid input."""
    return import_module("rig.errors").RigError
