"""The table of subcommands: where each one's function is, so that nothing else has to import it."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple


class Command(NamedTuple):
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
    "simulate": Command(
        "slider_jax.cli.simulate:simulate", "an experiment, or a pressure log, to thrust"
    ),
    "demo": Command("slider_jax.cli.demo:demo", "the paper's frequency sweep, no input needed"),
    "sweep": Command(
        "slider_jax.cli.sweep:sweep", "one or two fields of an experiment over ranges"
    ),
    "swim": Command("slider_jax.cli.swim:swim", "the robot set free, and its steady speed"),
    "climb": Command("slider_jax.cli.climb:climb", "the robot pinned to a wall, in air"),
    "optimize swim": Command(
        "slider_jax.cli.optimize:swim", "tail and gait for the fastest swimming"
    ),
    "optimize multimodal": Command(
        "slider_jax.cli.optimize:multimodal", "one tail to swim and to climb with"
    ),
    "close-loop": Command(
        "calibration.cli.close_loop:close_loop", "what a model lacks, from measured trials"
    ),
    "lamprey": Command(
        "calibration.cli.lamprey:lamprey", "a swimming animal's midlines, weighed by the model"
    ),
    "published": Command(
        "calibration.cli.published:published", "the paper's swimming speeds against its equations"
    ),
    "effects matrix": Command(
        "calibration.cli.effects_matrix:matrix",
        "which of them an experiment could find and separate",
    ),
    "effects": Command(
        "slider_jax.cli.effects:effects",
        "what a model may lack, and what it does to the sensors",
        alone=True,
    ),
    "calibrate manifold": Command(
        "calibration.cli.calibrate:manifold", "the pressure lag from the rig's own logs"
    ),
    "calibrate statics": Command(
        "calibration.cli.calibrate_statics:statics", "EI, damping and K_Q from a bench, in air"
    ),
    "calibrate": Command(
        "calibration.cli.calibrate_tank:tank", "C_d, m_a, k and K_Q from measured trials"
    ),
    "rig ports": Command("rig.cli.shared:ports", "this computer's serial ports", jax=False),
    "rig check": Command(
        "rig.cli.check:check", "line, noise and leaks of a rig, in a minute", jax=False
    ),
    "rig run": Command("rig.cli.run:run", "an experiment's trials on the rig, recorded", jax=False),
    "rig log": Command("rig.cli.log:log", "pressure logs of the published firmware", jax=False),
    "rig replay": Command(
        "rig.cli.replay:replay",
        "a recording's columns anew, or at its own pace",
        jax=False,
    ),
    "rig watch": Command(
        "rig.cli.watch:watch", "the calibrated model beside a running rig, with alarm"
    ),
    "rig loop": Command("rig.cli.loop:loop", "measure and close the loop until it is settled"),
    "rig simulate": Command(
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
