"""Reads an experiment (a TOML file and measured CSV files) and builds the models of the trials."""

from dataclasses import fields
from math import isfinite
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import PrivateAttr

from slider_jax.actuation import FirstOrderLag, Ideal, PressureLaw
from slider_jax.beam.grid import split_cells
from slider_jax.beam.parameters import Numerics, Robot, Scalar
from slider_jax.channels import TIME, ChannelSet
from slider_jax.dynamics.model import Model, SpaceSettings
from slider_jax.dynamics.time_schemes import SCHEMES, Scheme
from slider_jax.effects import Effect, NormalDrag, ReactiveForce, in_space
from slider_jax.effects.library import KNOWN_EFFECTS, LIBRARY
from slider_jax.errors import InputError, did_you_mean
from slider_jax.experiment.declared_channels import declared_channels
from slider_jax.experiment.drive import actuation_of
from slider_jax.experiment.robot import robot_of
from slider_jax.experiment.schema import EffectTable, ExperimentTable, ParametersTable, Trial
from slider_jax.experiment.trial_water import water_of
from slider_jax.io.csv import read_csv
from slider_jax.io.files import input_files
from slider_jax.io.toml import read_toml, validate
from slider_jax.paper import force_coefficients
from slider_jax.supports import Clamped, Free, Support


class Experiment(ExperimentTable):
    """A validated experiment, with the folder that contains the files of its trials."""

    _folder: Path = PrivateAttr(default=Path("."))

    @property
    def folder(self) -> Path:
        """The folder of the experiment file."""
        return self._folder

    @property
    def profiles(self) -> list[dict[str, Any]]:
        """Paths and SHA-256 digests of the files that robot, water and actuators need."""
        return input_files(*(self.folder / name for name in self.files))

    @property
    def channels(self) -> ChannelSet:
        """The channels of the experiment's sensors."""
        return declared_channels(self.chamber_names, self.sensors.channels)

    def robot_model(self) -> Robot:
        """Returns the robot. Raises `InputError` if the profile of a segment is invalid."""
        return robot_of(self.robot, self.parameters.K_Q, self.folder, self.chambers)

    def with_values(self, values: dict[str, Any], source: str = "change") -> "Experiment":
        """Returns a validated copy with new `values`, such as {"trials.0.frequency": 2.0}."""
        content = self.model_dump()
        for path, value in values.items():
            *parents, last = path.split(".")
            table: Any = content
            try:
                for part in parents:
                    table = table[int(part) if isinstance(table, (list, tuple)) else part]
                table[last]
            except (KeyError, IndexError, ValueError, TypeError):
                raise InputError(
                    f"{source}: {path}: no such field; allowed are fields such as robot.EI_tail, "
                    "parameters.C_d and trials.0.frequency"
                ) from None
            table[last] = value
        return _experiment(content, source, self.folder)


def _experiment(content: dict[str, Any], source: str, folder: Path) -> Experiment:
    experiment = validate(Experiment, content, source)
    experiment._folder = folder
    for index, table in enumerate(experiment.effects):
        effect = _effect(table, f"{source}: effects.{index}")
        if experiment.dimension == 3:
            _require_space(effect, table, f"{source}: effects.{index}")
        for key in effect.needs_density:
            if getattr(effect, key) and not experiment.robot.has_density:
                raise InputError(
                    f"{source}: effects.{index}.{key}: given {getattr(effect, key)}, but the robot "
                    "displaces no water without a density; add robot.density, or a density of each "
                    "segment"
                )
    try:
        experiment.channels  # noqa: B018  (two channels must not have the same name or column)
    except InputError as error:
        raise InputError(f"{source}: sensors.channels: {error}") from None
    return experiment


def load(path: Path | str, model: Path | str | None = None, *, spatial: bool = False) -> Experiment:
    """Returns the validated experiment of the file `path`, changed by the file `model` if given.

    Keys of `[robot]` and `[parameters]` in the model file replace keys of the experiment. The
    `[[effects]]` of both files are combined. C_d or m_a in the model file replaces a ramp or table
    of the experiment; a ramp or table replaces C_d and m_a. `InputError` names file and key. An
    experiment in three dimensions is an error, unless `spatial` is true.
    """
    path = Path(path)
    experiment = assemble(read_toml(path), str(path), path.parent, model)
    if experiment.dimension == 3 and not spatial:
        raise InputError(
            f"{path}: dimension: given 3; allowed 2, because this command computes in the plane; "
            "`slider simulate` and `slider swim` compute in three dimensions"
        )
    return experiment


def assemble(
    content: dict[str, Any], source: str, folder: Path, model: Path | str | None = None
) -> Experiment:
    """Returns the experiment of the tables `content`, as in `load`. Errors name `source`."""
    experiment = _experiment(content, source, folder)
    if model is None:
        return experiment
    changes = read_toml(Path(model))
    allowed = {
        "name": (str, "a string"),
        "robot": (dict, "a table [robot]"),
        "parameters": (dict, "a table [parameters]"),
        "effects": (list, "a list of tables [[effects]]"),
    }
    for key, value in changes.items():
        if key not in allowed:
            raise InputError(f"{model}: {key}: unknown key; allowed {', '.join(allowed)}")
        kind, text = allowed[key]
        if not isinstance(value, kind):
            raise InputError.value(f"{model}: {key}", value, text)
    changed = changes.get("parameters", {})
    replaced: set[str] = set()
    if changed.get("force_coefficients") in ("ramp", "table"):
        replaced = {"C_d", "m_a", "coefficients"}
    elif not changed.keys().isdisjoint(("C_d", "m_a")):
        replaced = {"force_coefficients", "coefficients"}
    kept = {key: x for key, x in content["parameters"].items() if key not in replaced}
    merged = content | {
        "robot": content["robot"] | changes.get("robot", {}),
        "parameters": kept | changed,
        "effects": [*content.get("effects", []), *changes.get("effects", [])],
    }
    return _experiment(merged, str(model), folder)


def trial_conditions(experiment: Experiment, trial: Trial) -> dict[str, float]:
    """Returns default values for fields of effects, from the experiment and `trial`.

    The keys are names of fields. A default applies if the `[[effects]]` table omits the field.
    """
    return {
        "density": experiment.robot.water_density,
        "stride_frequency": trial.frequency or 1.0,
        "tow_speed": trial.tow_speed,
    }


def _require_space(effect: Effect, table: EffectTable, where: str) -> None:
    """Refuses an effect that is planar only, or whose table omits what it needs in space."""
    if not in_space(effect):
        known = [name for name, kind in LIBRARY.items() if in_space(kind)]
        raise InputError(
            f"{where}.name: given {table.name!r}, which is defined in the plane only; allowed with "
            f"dimension = 3: {', '.join(known)}"
        )
    for name in effect.needed_in_space:
        if name not in (table.model_extra or {}):
            raise InputError(
                f"{where}.{name}: missing; with dimension = 3, add this key to the effect "
                f"{table.name!r}; slider effects {table.name} explains it"
            )


def _effect(table: EffectTable, where: str, taken: dict[str, float] | None = None) -> Effect:
    """Returns the effect of `table`. Fields that the table omits take their values from `taken`."""
    if table.name not in KNOWN_EFFECTS:
        raise InputError(
            f"{where}.name: given {table.name!r}; allowed {', '.join(LIBRARY)}; every model "
            "contains drag and added mass (parameters.C_d and parameters.m_a); the option "
            "--effects FILE.py adds effects of your own file"
            f"{did_you_mean(table.name, LIBRARY)}"
        )
    kind, given = KNOWN_EFFECTS[table.name], dict(table.model_extra or {})
    known = [field.name for field in fields(kind)]
    for key, value in given.items():
        if key not in known:
            raise InputError(f"{where}.{key}: unknown key; allowed {', '.join(known)}")
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
            raise InputError(f"{where}.{key}: given {value!r}; allowed a finite number")
    return kind(**{key: x for key, x in (taken or {}).items() if key in known} | given)


def to_numerics(experiment: Experiment) -> tuple[Numerics, Scheme]:
    """Returns the numerical settings and the time scheme of an experiment."""
    robot, numerics = experiment.robot, experiment.numerics
    cells = split_cells(numerics.nodes, *robot.lengths)
    return Numerics(*cells, tolerance=numerics.tolerance), SCHEMES[numerics.scheme]


def coefficients_at(parameters: ParametersTable, frequency: Scalar | None):
    """Returns (C_d, m_a) at a stride frequency [Hz], differentiable in the frequency."""
    if parameters.force_coefficients == "fixed":
        return parameters.C_d, parameters.m_a
    assert frequency is not None
    if parameters.force_coefficients == "ramp":
        return force_coefficients(frequency)
    table = parameters.coefficients
    at = jnp.asarray([x.frequency for x in table])
    C_d, m_a = ([getattr(x, name) for x in table] for name in ("C_d", "m_a"))
    return jnp.interp(frequency, at, jnp.asarray(C_d)), jnp.interp(frequency, at, jnp.asarray(m_a))


def drag_and_added_mass(experiment: Experiment, trial: Trial) -> tuple[float, float]:
    """Returns (C_d, m_a) of a trial from the experiment file or from the paper's ramp."""
    C_d, m_a = coefficients_at(experiment.parameters, trial.frequency)
    return float(C_d), float(m_a)


def to_model(experiment: Experiment, trial: Trial | int = 0) -> Model:
    """Returns the model of one trial, with arrays as leaves that JAX can differentiate.

    Models of trials with the same waveform have the same tree structure, so `jax.tree.map` can
    stack them for vmap. Raises `InputError` if a recorded drive is invalid.
    """
    if isinstance(trial, int):
        trial = experiment.trials[trial]
    density = experiment.robot.water_density
    taken = trial_conditions(experiment, trial)
    C_d, m_a = drag_and_added_mass(experiment, trial)
    measured = trial.waveform == "recorded" and trial.drive_is == "measured"
    law: PressureLaw = Ideal() if measured else lag_of(experiment)
    extra = [_effect(table, "effects", taken) for table in experiment.effects]
    drive, actuators = actuation_of(experiment, trial, experiment.folder)
    model = Model(
        robot=experiment.robot_model(),
        effects=(NormalDrag(C_d, density), ReactiveForce(m_a, density), *extra),
        pressure_law=law,
        drive=drive,
        support=_support(trial),
        water=water_of(experiment, trial, experiment.folder),
        actuators=actuators,
        space=_space_of(experiment, trial),
    )
    return jax.tree.map(lambda x: jnp.asarray(x, float), model)


def _space_of(experiment: Experiment, trial: Trial) -> SpaceSettings | None:
    if experiment.dimension == 2:
        return None
    chambers = experiment.chambers
    near, far = (jnp.array([x.angle[i] for x in chambers]) for i in (0, 1))
    if all(x.distance is None for x in chambers):
        return SpaceSettings(near, trial.roll)
    return SpaceSettings(near, trial.roll, far, jnp.array([x.distance or 0.0 for x in chambers]))


def lag_of(experiment: Experiment) -> FirstOrderLag:
    """Returns the lag of the experiment's chambers."""
    ratios = [x.k_ratio for x in experiment.chambers]
    alike = all(x == 1.0 for x in ratios)
    return FirstOrderLag(experiment.parameters.k, None if alike else jnp.array(ratios))


def _support(trial: Trial) -> Support:
    if trial.support == "free":
        return Free(trial.start_speed, trial.heading)
    return Clamped(
        tow_speed=trial.tow_speed,
        heave=trial.heave,
        pitch=trial.pitch,
        frequency=trial.clamp_frequency or trial.frequency or 0.0,
        pitch_phase=trial.pitch_phase,
    )


def read_measured(experiment: Experiment, trial: Trial) -> dict[str, np.ndarray] | None:
    """Returns the columns of a trial's measured file, or None if this file does not exist.

    Only `t_s` is required; blank cells of other columns become NaN. Raises `InputError` if the file
    is invalid or contradicts the experiment.
    """
    path = experiment.folder / trial.file
    if not path.exists():
        return None
    columns = read_csv(path, (TIME,), blank=experiment.channels.columns[1:])
    times = columns["t_s"]
    if times[0] < 0.0 or times[-1] > trial.duration * (1.0 + 1e-6):
        raise InputError(
            f"{path}: samples from {times[0]:g} to {times[-1]:g} s; allowed 0 to the trial's "
            f"duration of {trial.duration:g} s; correct the file or the duration of {trial.file}"
        )
    rate, declared = 1.0 / float(np.median(np.diff(times))), experiment.sensors.sample_rate
    if "sensors" in experiment.model_fields_set and abs(rate - declared) > 0.05 * declared:
        raise InputError(
            f"{path}: sampled at {rate:.6g} Hz, but sensors.sample_rate is {declared:g} Hz; give "
            "each sample rate its own experiment file"
        )
    return columns
