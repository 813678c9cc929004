"""Defines the rig file RIG.toml: the devices of a lab's rig and their settings."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from rig.recording.table import AnalogueSensor
from slider_jax.errors import InputError
from slider_jax.experiment.tables import FROM_LIST, Table, fail
from slider_jax.io.toml import read_toml, validate
from slider_jax.io.units import Quantity

Pressure = Annotated[float, Quantity(1e3, 2e6, "Pa")]
FROM_NUMBER = BeforeValidator(lambda x: (x,) if isinstance(x, (int, float)) else x)
Axis = Literal["+Fx", "-Fx", "+Fy", "-Fy", "+Fz", "-Fz"]


class ManifoldTable(Table):
    """[manifold]: highest set pressures, command rate, durations of pauses.

    `limits` are one value for all chambers, or one value for each chamber.
    """

    limits: Annotated[tuple[Pressure, ...], FROM_LIST, FROM_NUMBER, Field(min_length=1)] = (250e3,)
    commands_per_second: Annotated[float, Quantity(50.0, 1000.0, "Hz")] = 200.0
    quiet: Annotated[float, Quantity(0.2, 60.0, "s")] = 1.0
    fade: Annotated[float, Quantity(0.0, 60.0, "s")] = 2.0
    after: Annotated[float, Quantity(0.1, 60.0, "s")] = 0.3
    pause: Annotated[float, Quantity(0.0, 3600.0, "s")] = 2.0
    longest_pause: Annotated[float, Quantity(0.0, 3600.0, "s")] = 60.0


class ForceTable(Table):
    """[force]: an ATI Net F/T box, and the box's axes that measure thrust and recoil.

    If the counts per N and per N m are missing, they are read from the box's web page.
    """

    host: str
    port: Annotated[int, Field(ge=1, le=65535)] = 49152
    page_port: Annotated[int, Field(ge=1, le=65535)] = 80
    thrust: Axis = "+Fx"
    recoil: Axis = "+Fy"
    counts_per_N: Annotated[float, Quantity(1.0, 1e9)] | None = None
    counts_per_Nm: Annotated[float, Quantity(1.0, 1e9)] | None = None

    @model_validator(mode="after")
    def _both_counts(self) -> "ForceTable":
        if (self.counts_per_N is None) != (self.counts_per_Nm is None):
            fail(
                "counts_per_N",
                "one of the two counts",
                "both or none of counts_per_N, counts_per_Nm",
            )
        return self


class CameraTable(Table):
    """[camera]: video file or number of a device, number of blue markers, scale of the image."""

    source: int | str
    markers: Annotated[int, Field(ge=2, le=50)]
    head: Annotated[tuple[float, float], FROM_LIST]
    px_per_metre: Annotated[float, Quantity(10.0, 1e6, "px/m")]
    from_below: bool = False
    fps: Annotated[float, Quantity(1.0, 10e3, "Hz")] | None = None
    gate: Annotated[float, Quantity(1.0, 1e4, "px")] | None = None


class AnalogueTable(Table):
    """[[analogue]]: a sensor at an analogue input. Its value is scale * (voltage - zero)."""

    column: Literal["thrust_N", "recoil_N", "tip_m"]
    input: Literal[1, 2, 3]
    scale: float
    zero: float | None = None

    def sensor(self) -> AnalogueSensor:
        """Returns the sensor of this table."""
        return AnalogueSensor(self.column, self.input, self.scale, self.zero)


class RigTable(Table):
    """All tables of a rig file."""

    manifold: ManifoldTable = ManifoldTable()
    force: ForceTable | None = None
    camera: CameraTable | None = None
    analogue: Annotated[tuple[AnalogueTable, ...], FROM_LIST] = ()

    @model_validator(mode="after")
    def _one_sensor_a_column(self) -> "RigTable":
        given = ["thrust_N", "recoil_N"] if self.force else []
        given += ["tip_m"] if self.camera else []
        for index, sensor in enumerate(self.analogue):
            if sensor.column in given:
                fail(f"analogue.{index}.column", sensor.column, "a column without another sensor")
            given.append(sensor.column)
        return self


def load_rig(path: Path | None, changes: dict[str, Any] | None = None) -> RigTable:
    """Returns the settings of a rig file, or the defaults if `path` is None.

    `changes` maps a table's name to the values that the command line sets. Raises `InputError`.
    """
    content = read_toml(path) if path is not None else {}
    if "robot" in content or "trials" in content:
        raise InputError(
            f"--rig {path}: is an experiment file; give a rig file, with [manifold], [force] or "
            "[[analogue]]"
        )
    for table, values in (changes or {}).items():
        given = content.get(table, {})
        if not isinstance(given, dict):
            raise InputError(f"{path}: {table}: given {given!r}; allowed a TOML table")
        content[table] = given | values
    return validate(RigTable, content, str(path) if path is not None else "command line")
