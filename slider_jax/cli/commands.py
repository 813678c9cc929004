"""Lists the subcommands of `slider`. Python imports only the module of the called subcommand."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple


class Subcommand(NamedTuple):
    """A subcommand: its function, written as `module:function`, and one line of help text.

    The package tyro builds the options from the signature. The function may return an exit code.
    """

    target: str
    help: str
    alone: bool = False
    """Whether the name is a command and also the first word of other commands (`effects`)."""
    jax: bool = True
    """Whether the command needs JAX, which may not be installed on the rig's computer."""
    effects: bool = False
    """Whether `call_of` adds the option --effects, which loads effect files for the command."""


COMMANDS = {
    "simulate": Subcommand(
        "slider_jax.cli.simulate:simulate",
        "simulates the trials of an experiment, or the thrust from a pressure log",
        effects=True,
    ),
    "export": Subcommand(
        "slider_jax.cli.simulate:export_shape",
        "converts the shape of a simulated robot to files for ParaView",
    ),
    "demo": Subcommand(
        "slider_jax.cli.demo:demo", "simulates the paper's frequency sweep, without an input file"
    ),
    "sweep": Subcommand(
        "slider_jax.cli.sweep:sweep",
        "simulates a trial for many values of one or two parameters",
        effects=True,
    ),
    "swim": Subcommand(
        "slider_jax.cli.swim:swim",
        "simulates free swimming and computes the steady speed",
        effects=True,
    ),
    "climb": Subcommand(
        "slider_jax.cli.swim:climb", "simulates a robot that climbs a wall in air", effects=True
    ),
    "transition": Subcommand(
        "slider_jax.cli.swim:transition",
        "simulates a robot that swims to a wall and climbs out of the water",
        effects=True,
    ),
    "statics": Subcommand(
        "slider_jax.cli.statics:rod_statics",
        "computes the shape of a rod at rest under loads, in three dimensions",
    ),
    "optimize swim": Subcommand(
        "slider_jax.cli.optimize:optimize_swim", "optimises tail and drive for the fastest swimming"
    ),
    "optimize multimodal": Subcommand(
        "slider_jax.cli.optimize:optimize_multimodal",
        "optimises one tail for both swimming and climbing",
    ),
    "optimize transition": Subcommand(
        "slider_jax.cli.optimize:optimize_transition",
        "optimises the gait's schedule and the tail on the way from the water to the wall",
    ),
    "close-loop": Subcommand(
        "calibration.cli.close_loop:close_loop",
        "finds out from measured trials which effects a model lacks",
        effects=True,
    ),
    "warm-up": Subcommand(
        "calibration.cli.warm_up:warm_up",
        "compiles the programs of the everyday commands, so that their first call is faster",
    ),
    "lamprey": Subcommand(
        "calibration.cli.lamprey:lamprey",
        "computes the axial force balance of a swimming animal from measured midlines",
    ),
    "published": Subcommand(
        "calibration.cli.published:published",
        "compares the paper's statements or its swimming speeds with simulations",
    ),
    "effects matrix": Subcommand(
        "calibration.cli.effects_matrix:effects_matrix",
        "computes which effects an experiment can detect, and which it cannot discriminate",
        effects=True,
    ),
    "effects": Subcommand(
        "slider_jax.cli.effects:list_effects",
        "lists the effects of the library, or explains one effect",
        alone=True,
        effects=True,
    ),
    "calibrate manifold": Subcommand(
        "calibration.cli.calibrate:manifold", "fits the pressure lag to pressure logs of the rig"
    ),
    "calibrate statics": Subcommand(
        "calibration.cli.calibrate_statics:statics",
        "fits bending stiffness, damping and K_Q to bench tests in air",
    ),
    "calibrate": Subcommand(
        "calibration.cli.calibrate_tank:tank",
        "fits C_d, m_a, k and K_Q to measured trials",
        effects=True,
    ),
    "rig ports": Subcommand(
        "rig.cli.shared:rig_ports", "lists this computer's serial ports", jax=False
    ),
    "rig check": Subcommand(
        "rig.cli.check:rig_check",
        "checks the serial line, the sensor noise and the leaks of a rig in a minute",
        jax=False,
    ),
    "rig run": Subcommand(
        "rig.cli.run:rig_run", "runs and records the trials of an experiment on the rig", jax=False
    ),
    "rig log": Subcommand(
        "rig.cli.log:rig_log", "records pressure logs with the published firmware", jax=False
    ),
    "rig replay": Subcommand(
        "rig.cli.replay:rig_replay", "converts recordings to CSV, or plays them back", jax=False
    ),
    "rig watch": Subcommand(
        "rig.cli.watch:rig_watch",
        "runs the calibrated model in parallel with the rig and raises alarms",
        effects=True,
    ),
    "rig loop": Subcommand(
        "rig.cli.loop:rig_loop",
        "measures trials, finds missing effects, and adds trials",
        effects=True,
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
    """Imports the module of a `target`, written as `module:function`, and returns the function."""
    module, function = target.split(":")
    return getattr(import_module(module), function)


def rig_error() -> type[Exception]:
    """Returns the exception class that the rig's commands raise for invalid input."""
    return import_module("rig.errors").RigError
