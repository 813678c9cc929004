"""The table of subcommands: where each one's function is, so that nothing else has to import it."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple


class Subcommand(NamedTuple):
    """A subcommand: `module:function`, imported only when it is asked for, and a line of help.

    The function's signature is the command line, by tyro; it returns None or an exit code.
    """

    target: str
    help: str
    alone: bool = False
    """Of a group's own command: whether it runs without arguments, and takes bare words."""
    jax: bool = True
    """Whether it needs JAX, which the computer beside a tank may lack."""


COMMANDS = {
    "simulate": Subcommand(
        "slider_jax.cli.simulate:simulate", "an experiment, or a pressure log, to thrust"
    ),
    "demo": Subcommand("slider_jax.cli.demo:demo", "the paper's frequency sweep, no input needed"),
    "sweep": Subcommand(
        "slider_jax.cli.sweep:sweep", "one or two fields of an experiment over ranges"
    ),
    "swim": Subcommand("slider_jax.cli.swim:swim", "the robot set free, and its steady speed"),
    "climb": Subcommand("slider_jax.cli.climb:climb", "the robot pinned to a wall, in air"),
    "optimize swim": Subcommand(
        "slider_jax.cli.optimize:optimize_swim", "tail and gait for the fastest swimming"
    ),
    "optimize multimodal": Subcommand(
        "slider_jax.cli.optimize:optimize_multimodal", "one tail to swim and to climb with"
    ),
    "close-loop": Subcommand(
        "calibration.cli.close_loop:close_loop", "what a model lacks, from measured trials"
    ),
    "lamprey": Subcommand(
        "calibration.cli.lamprey:lamprey", "a swimming animal's midlines, weighed by the model"
    ),
    "published": Subcommand(
        "calibration.cli.published:published", "the paper's swimming speeds against its equations"
    ),
    "effects matrix": Subcommand(
        "calibration.cli.effects_matrix:effects_matrix",
        "which of them an experiment could find and separate",
    ),
    "effects": Subcommand(
        "slider_jax.cli.effects:effects",
        "what a model may lack, and what it does to the sensors",
        alone=True,
    ),
    "calibrate manifold": Subcommand(
        "calibration.cli.calibrate:manifold", "the pressure lag from the rig's own logs"
    ),
    "calibrate statics": Subcommand(
        "calibration.cli.calibrate_statics:statics", "EI, damping and K_Q from a bench, in air"
    ),
    "calibrate": Subcommand(
        "calibration.cli.calibrate_tank:tank", "C_d, m_a, k and K_Q from measured trials"
    ),
    "rig ports": Subcommand("rig.cli.shared:ports", "this computer's serial ports", jax=False),
    "rig check": Subcommand(
        "rig.cli.check:check", "line, noise and leaks of a rig, in a minute", jax=False
    ),
    "rig run": Subcommand(
        "rig.cli.run:run", "an experiment's trials on the rig, recorded", jax=False
    ),
    "rig log": Subcommand("rig.cli.log:log", "pressure logs of the published firmware", jax=False),
    "rig replay": Subcommand(
        "rig.cli.replay:replay",
        "a recording's columns anew, or at its own pace",
        jax=False,
    ),
    "rig watch": Subcommand(
        "rig.cli.watch:watch", "the calibrated model beside a running rig, with alarm"
    ),
    "rig loop": Subcommand("rig.cli.loop:loop", "measure and close the loop until it is settled"),
    "rig simulate": Subcommand(
        "rig.cli.simulate:simulate",
        "a rig that is not there, to try all this on",
        jax=False,
    ),
}

SIMULATE_LOG = "calibration.cli.simulate_log:simulate_log"
"""What `slider simulate` calls for a pressure log."""


def function_of(target: str) -> Callable[..., Any]:
    """The function that a `module:function` of the table names; its module is imported now."""
    module, function = target.split(":")
    return getattr(import_module(module), function)


def rig_error() -> type[Exception]:
    """What the commands of the rig raise for one clear message."""
    return import_module("rig.errors").RigError
