"""Defines the tables of an experiment file: keys, units and plausible ranges."""

from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from slider_jax.io.units import Quantity

Length = Annotated[float, Quantity(0.0, 3.0, "m")]
Stiffness = Annotated[float, Quantity(1.0, 1e7, "N")]
Speed = Annotated[float, Quantity(-3.0, 3.0, "m/s")]
Force = Annotated[float, Quantity(0.0, 10.0, "N")]
Share = Annotated[float, Quantity(0.0, 0.5)]
FEWEST_NODES = 11
"""Smallest number of nodes along a robot; fewer nodes do not resolve the bending."""
FROM_LIST = BeforeValidator(lambda x: tuple(x) if isinstance(x, list) else x)


def _plain_name(name: str) -> str:
    """Returns `name`, or raises an error if `name` is not a CSV file name without folder."""
    parts = PurePath(name.replace("\\", "/")).parts
    if len(parts) != 1 or parts[0] in ("..", ".") or not name.endswith(".csv"):
        raise PydanticCustomError(
            "file_name",
            "given {given}; allowed a plain file name without folder, ending in .csv",
            {"given": repr(name)},
        )
    return name


FileName = Annotated[str, AfterValidator(_plain_name)]


class Table(BaseModel):
    """A table of an experiment file. Unknown keys are errors, and values are immutable."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class RobotTable(Table):
    """[robot]: measured geometry and structure. Chamber spans are distances from the clamp."""

    body_length: Annotated[float, Quantity(0.05, 3.0, "m")]
    tail_length: Annotated[float, Quantity(0.005, 2.0, "m")]
    linear_density: Annotated[float, Quantity(0.01, 20.0, "kg/m")]
    EI_body: Annotated[float, Quantity(1e-4, 100.0, "N m^2")]
    EI_tail: Annotated[float, Quantity(1e-6, 100.0, "N m^2")]
    EA_body: Stiffness = 1.0e5
    EA_tail: Stiffness = 1.0e5
    damping_time: Annotated[float, Quantity(0.0, 0.1, "s")]
    height: Annotated[float, Quantity(0.002, 0.5, "m")]
    front_chamber: Annotated[tuple[Length, Length], FROM_LIST]
    rear_chamber: Annotated[tuple[Length, Length], FROM_LIST]
    water_density: Annotated[float, Quantity(900.0, 1300.0, "kg/m^3")] = 1000.0

    @model_validator(mode="after")
    def _chambers_do_not_overlap(self) -> "RobotTable":
        spans = {"front_chamber": self.front_chamber, "rear_chamber": self.rear_chamber}
        for name, (near, far) in spans.items():
            if near >= far:
                _fail(name, [near, far], "[near, far] with near < far, distances from the clamp")
            if far > self.body_length:
                _fail(name, [near, far], f"spans within the body, 0 to {self.body_length:g} m")
        if self.front_chamber[1] > self.rear_chamber[0]:
            _fail(
                "rear_chamber",
                list(self.rear_chamber),
                f"a near end of at least {self.front_chamber[1]:g} m, the front chamber's far end",
            )
        return self


Drag = Annotated[float, Quantity(0.0, 20.0)]
AddedMass = Annotated[float, Quantity(0.0, 5.0)]


class CoefficientsAt(Table):
    """[[parameters.coefficients]]: C_d and m_a of trials at one drive frequency."""

    frequency: Annotated[float, Quantity(0.05, 20.0, "Hz")]
    C_d: Drag
    m_a: AddedMass


class ParametersTable(Table):
    """[parameters]: the values that calibration identifies.

    `force_coefficients` is the source of C_d and m_a. With "fixed", C_d and m_a are the numbers in
    this table. With "ramp", `paper.force_coefficients` returns both for the trial's frequency. With
    "table", C_d and m_a are interpolated linearly in the frequency, and constant outside the table.
    """

    force_coefficients: Literal["fixed", "ramp", "table"] = "fixed"
    C_d: Drag | None = None
    m_a: AddedMass | None = None
    coefficients: Annotated[tuple[CoefficientsAt, ...], FROM_LIST] = ()
    k: Annotated[float, Quantity(0.001, 2.0, "s")]
    K_Q: Annotated[float, Quantity(1e-9, 1e-4, "m^3")]

    @model_validator(mode="after")
    def _coefficients_come_from_one_place(self) -> "ParametersTable":
        for name in ("C_d", "m_a"):
            given = getattr(self, name)
            if self.force_coefficients == "fixed" and given is None:
                _fail(name, "nothing", 'a number, unless force_coefficients is "ramp" or "table"')
            if self.force_coefficients != "fixed" and given is not None:
                _fail(name, given, 'only with force_coefficients = "fixed"; omit this key')
        given_at = [x.frequency for x in self.coefficients]
        if (self.force_coefficients == "table") != bool(given_at):
            allowed = 'at least one table if force_coefficients = "table", otherwise none'
            _fail("coefficients", f"{len(given_at)} tables", allowed)
        if any(b <= a for a, b in zip(given_at, given_at[1:], strict=False)):
            _fail("coefficients", given_at, "frequencies that increase from table to table")
        return self


class SensorsTable(Table):
    """[sensors]: standard deviations and correlation time of sensor errors, and sample rate.

    Gains are fractions of the reading, and discrepancies are fractions of the channel's rms.
    """

    pressure_noise: Annotated[float, Quantity(0.0, 1e5, "Pa")] = 0.0
    force_noise: Force = 0.0
    force_tare: Force = 0.0
    force_slow_noise: Force = 0.0
    force_slow_time: Annotated[float, Quantity(1e-3, 100.0, "s")] = 0.1
    tip_noise: Annotated[float, Quantity(0.0, 0.1, "m")] = 0.0
    start_swing: Annotated[float, Quantity(0.0, 0.1, "m")] = 0.0
    pressure_gain: Share | None = None
    thrust_gain: Share | None = None
    recoil_gain: Share | None = None
    tip_gain: Share | None = None
    pressure_discrepancy: Share | None = None
    thrust_discrepancy: Share | None = None
    recoil_discrepancy: Share | None = None
    tip_discrepancy: Share | None = None
    sample_rate: Annotated[float, Quantity(1.0, 1e5, "Hz")] = 500.0


class WaterTable(Table):
    """[water]: velocity (x, y) of a steady uniform stream; x points forward, y to the left."""

    velocity: Annotated[tuple[Speed, Speed], FROM_LIST] = (0.0, 0.0)


class NumericsTable(Table):
    """[numerics]: nodes along the robot, longest time step, time scheme and solver tolerance."""

    nodes: Annotated[int, Field(strict=True, ge=FEWEST_NODES, le=1001)] = 51
    step: Annotated[float, Quantity(1e-5, 0.02, "s")] = 1e-3
    scheme: Literal["sdirk2", "backward_euler"] = "sdirk2"
    tolerance: Annotated[float, Quantity(1e-10, 1e-3)] = 1e-8


class Trial(Table):
    """[[trials]]: one trial. The rear set pressure is `rear_ratio` times the front set pressure and
    `phase` periods later. A recorded drive contains set or measured pressures (`drive_is`)."""

    file: FileName
    waveform: Literal["square", "sine", "trapezoid", "recorded"] = "square"
    frequency: Annotated[float, Quantity(0.05, 20.0, "Hz")] | None = None
    amplitude: Annotated[float, Quantity(1e3, 2e6, "Pa", or_zero=True)] | None = None
    rear_ratio: Annotated[float, Quantity(-20.0, 20.0)] = 1.0
    phase: Annotated[float, Quantity(-1.0, 1.0, "fraction of a period")] = 0.0
    rise: Annotated[float, Quantity(0.001, 0.5, "fraction of a period")] = 0.1
    drive_file: FileName | None = None
    drive_is: Literal["set", "measured"] = "set"
    tow_speed: Speed = 0.0
    heave: Annotated[float, Quantity(0.0, 0.5, "m")] = 0.0
    pitch: Annotated[float, Quantity(-1.2, 1.2, "rad")] = 0.0
    pitch_phase: Annotated[float, Quantity(-6.2832, 6.2832, "rad")] = 0.0
    clamp_frequency: Annotated[float, Quantity(0.05, 20.0, "Hz")] | None = None
    duration: Annotated[float, Quantity(0.01, 600.0, "s")]
    initial: Any = None  # accepted, but not used

    @model_validator(mode="after")
    def _drive_is_complete(self) -> "Trial":
        if self.waveform == "recorded":
            if self.drive_file is None:
                _fail("drive_file", "nothing", 'a CSV file, because waveform is "recorded"')
            if self.drive_file == self.file:
                _fail("drive_file", repr(self.file), "a file other than the trial's `file`")
            return self
        for name in ("frequency", "amplitude"):
            if getattr(self, name) is None:
                _fail(name, "nothing", f'a number, because waveform is "{self.waveform}"')
        if self.drive_file is not None:
            _fail("drive_file", repr(self.drive_file), 'only with waveform = "recorded"')
        return self

    @property
    def clamp_moves(self) -> bool:
        """Whether the clamp heaves or pitches."""
        return self.heave != 0.0 or self.pitch != 0.0


class EffectTable(BaseModel):
    """[[effects]]: the name of an additional effect, and values of its parameters."""

    model_config = ConfigDict(frozen=True, extra="allow")
    name: str


class ExperimentTable(Table):
    """All tables of an experiment file."""

    name: str
    robot: RobotTable
    parameters: ParametersTable
    sensors: SensorsTable = SensorsTable()
    water: WaterTable = WaterTable()
    numerics: NumericsTable = NumericsTable()
    effects: Annotated[tuple[EffectTable, ...], FROM_LIST] = ()
    trials: Annotated[tuple[Trial, ...], FROM_LIST, Field(min_length=1)]

    @model_validator(mode="after")
    def _trials_agree(self) -> "ExperimentTable":
        seen: dict[str, int] = {}
        for index, trial in enumerate(self.trials):
            if trial.file in seen:
                allowed = f"a unique name; trials.{seen[trial.file]} has this name"
                _fail(f"trials.{index}.file", repr(trial.file), allowed)
            seen[trial.file] = index
            source = self.parameters.force_coefficients
            if source != "fixed" and trial.frequency is None:
                needed = f'a number, because parameters.force_coefficients is "{source}"'
                _fail(f"trials.{index}.frequency", "nothing", needed)
            fastest = max(trial.frequency or 0.0, trial.clamp_frequency or 0.0)
            if trial.clamp_moves and not fastest:
                _fail(f"trials.{index}.clamp_frequency", "nothing", "a number, as the clamp moves")
            if fastest and self.numerics.step > 0.05 / fastest:
                longest = f"{0.05 / fastest:.4g} s, a twentieth of the period of trials.{index}"
                _fail("numerics.step", self.numerics.step, f"at most {longest}")
        return self


def _fail(where: str, given: Any, allowed: str) -> None:
    """Raises a validation error for the key `where` of a table."""
    raise PydanticCustomError(
        "table",
        "{where}: given {given}; allowed {allowed}",
        {"where": where, "given": str(given), "allowed": allowed},
    )
