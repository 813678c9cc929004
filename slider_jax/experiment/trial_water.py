"""Builds the water of a trial: a uniform stream, a vortex street or a field from a file."""

from pathlib import Path

from slider_jax.errors import InputError
from slider_jax.experiment.schema import ExperimentTable, Trial
from slider_jax.water import VortexStreet, WaterField, karman_speed, read_field


def water_of(
    experiment: ExperimentTable, trial: Trial, folder: Path
) -> tuple[float, float] | WaterField | None:
    """Returns the water of a trial, checked for the time and the straight body's path.

    The value is None for still water. `folder` contains the file of a field. Raises `InputError` if
    the field is invalid.
    """
    table = experiment.water
    if table.vortex_street is not None:
        values, stream = table.vortex_street.model_dump(), table.velocity
        if values["advection"] is None:
            of_speed = (values[name] for name in ("spacing", "circulation", "ratio"))
            values["advection"] = stream[0] + karman_speed(*of_speed)
        return VortexStreet(stream=stream, **values)
    if table.field is None:
        return table.velocity if any(table.velocity) else None
    path = folder / table.field
    field = read_field(path)
    duration = trial.lead + trial.duration
    end = trial.tow_speed * duration
    covered = {
        "x_m": (min(end, 0.0) - sum(experiment.robot.lengths), max(end, 0.0)),
        "y_m": (-trial.heave, trial.heave),
    }
    if not field.periodic:
        covered["t_s"] = (0.0, duration)
    for name, (low, high) in covered.items():
        first, last = field.ends[name]
        if first > low + 1e-9 or last < high - 1e-9:
            what = (
                "the duration" if name == "t_s" else "the path of the straight robot, and a margin"
            )
            raise InputError(
                f"{path}: {name} covers {first:g} to {last:g}; allowed a field with {low:g} to "
                f"{high:g}, {what} in {trial.file}; give a larger field"
            )
    return field
