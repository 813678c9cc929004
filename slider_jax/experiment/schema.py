"""Defines the tables of an experiment file: keys, units and plausible ranges."""

from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)

from slider_jax.experiment.actuator_tables import (
    ActuatorTable,
    AnyActuator,
    ChamberTable,
    TendonTable,
    check_actuators,
)
from slider_jax.experiment.sensor_tables import SensorsTable
from slider_jax.experiment.tables import (
    FROM_LIST,
    BendingStiffness,
    DampingTime,
    Density,
    FileName,
    GridFileName,
    Height,
    Length,
    LinearDensity,
    PolarInertia,
    Position,
    Span,
    Speed,
    Stiffness,
    Table,
    TorsionalStiffness,
    WaterDensity,
    Width,
    fail,
)
from slider_jax.experiment.transition_table import TransitionTable
from slider_jax.io.units import Quantity

FEWEST_NODES = 11
"""Smallest number of nodes along a robot; fewer nodes do not resolve the bending."""


class BodyTable(Table):
    """The part of [robot] that all robots have. Spans are distances from the clamp."""

    front_chamber: Span | None = None
    rear_chamber: Span | None = None
    water_density: WaterDensity = 1000.0
    density: Density | None = None
    polar_inertia: PolarInertia | None = None
    width: Width | None = None

    @property
    def has_density(self) -> bool:
        """Whether the robot displaces water."""
        return self.density is not None

    @property
    def own_chambers(self) -> tuple[ChamberTable, ...]:
        """The chambers of the keys `front_chamber` and `rear_chamber`."""
        spans = {"front": self.front_chamber, "rear": self.rear_chamber}
        return tuple(
            ChamberTable(kind="pneumatic", name=name, span=span)
            for name, span in spans.items()
            if span is not None
        )

    @property
    def lengths(self) -> tuple[float, float]:
        """Lengths [m] of tail and body."""
        raise NotImplementedError

    @property
    def lacking_in_space(self) -> list[str]:
        """Keys without which the robot cannot be simulated in three dimensions."""
        raise NotImplementedError


class RobotTable(BodyTable):
    """[robot] of a robot with a uniform body and a uniform tail: geometry and structure."""

    body_length: Annotated[float, Quantity(0.05, 3.0, "m")]
    tail_length: Annotated[float, Quantity(0.005, 2.0, "m")]
    linear_density: LinearDensity
    EI_body: Annotated[float, Quantity(1e-4, 100.0, "N m^2")]
    EI_tail: BendingStiffness
    EA_body: Stiffness = 1.0e5
    EA_tail: Stiffness = 1.0e5
    damping_time: DampingTime
    height: Height
    GJ_body: TorsionalStiffness | None = None
    GJ_tail: TorsionalStiffness | None = None
    EI_n_body: BendingStiffness | None = None
    EI_n_tail: BendingStiffness | None = None

    @property
    def lengths(self) -> tuple[float, float]:
        return self.tail_length, self.body_length

    @property
    def lacking_in_space(self) -> list[str]:
        needed = ("GJ_body", "GJ_tail", "polar_inertia")
        return [key for key in needed if getattr(self, key) is None]


PROFILE_COLUMNS = {
    "linear_density": "linear_density_kg_per_m",
    "EI": "EI_N_m2",
    "EA": "EA_N",
    "damping_time": "damping_time_s",
    "height": "height_m",
}
"""Column of each property in the profile of a segment."""


class SegmentTable(Table):
    """[[robot.segments]]: one segment of the robot. The order is from the head to the tail's end.

    A property is the number in this table, a column of the CSV file `profile`, or the number in
    table [robot], which applies to all segments without an own value. A profile gives properties as
    linear functions of s_m, the distance from the segment's near end.
    """

    length: Annotated[float, Quantity(1e-3, 3.0, "m")]
    part: Literal["body", "tail"] = "body"
    linear_density: LinearDensity | None = None
    EI: BendingStiffness | None = None
    EA: Stiffness | None = None
    damping_time: DampingTime | None = None
    height: Height | None = None
    density: Density | None = None
    rigid: Annotated[bool, Field(strict=True)] = False
    profile: FileName | None = None

    GJ: TorsionalStiffness | None = None
    EI_n: BendingStiffness | None = None


class PointMassTable(Table):
    """[[robot.point_masses]]: a mass at a distance `s` from the head, for example an adapter."""

    s: Length
    mass: Annotated[float, Quantity(1e-4, 20.0, "kg")]


class SegmentedRobotTable(BodyTable):
    """[robot] of a robot with segments. The segments of the tail follow those of the body."""

    segments: Annotated[tuple[SegmentTable, ...], FROM_LIST, Field(min_length=1)]
    point_masses: Annotated[tuple[PointMassTable, ...], FROM_LIST] = ()
    linear_density: LinearDensity | None = None
    EI: BendingStiffness | None = None
    EA: Stiffness = 1.0e5
    damping_time: DampingTime | None = None
    height: Height | None = None
    GJ: TorsionalStiffness | None = None
    EI_n: BendingStiffness | None = None

    @property
    def lengths(self) -> tuple[float, float]:
        tail, body = (
            sum(x.length for x in self.segments if x.part == part) for part in ("tail", "body")
        )
        return tail, body

    @property
    def lacking_in_space(self) -> list[str]:
        segments = [
            f"segments.{i}.GJ" for i, x in enumerate(self.segments) if x.GJ is None and not x.rigid
        ]
        lacking = [] if self.GJ is not None else segments
        return [*lacking, *(["polar_inertia"] if self.polar_inertia is None else [])]

    @property
    def files(self) -> list[str]:
        return sorted({x.profile for x in self.segments if x.profile is not None})

    @property
    def has_density(self) -> bool:
        return any(self.density_of(x) is not None for x in self.segments)

    def density_of(self, segment: SegmentTable) -> float | None:
        """Returns the mean density [kg/m^3] of a segment."""
        return self.density if segment.density is None else segment.density

    @field_validator("segments")
    @classmethod
    def _body_is_before_tail(cls, segments: tuple[SegmentTable, ...]) -> tuple[SegmentTable, ...]:
        parts = [x.part for x in segments]
        if parts[0] != "body":
            fail("0.part", '"tail"', '"body"; the first segment belongs to the body')
        wrong = next((i for i, p in enumerate(parts[1:], 1) if p == "body" != parts[i - 1]), None)
        if wrong is not None:
            fail(f"{wrong}.part", '"body"', '"tail", because the segment before is in the tail')
        return segments

    @model_validator(mode="after")
    def _segments_are_complete(self) -> Self:
        for i, x in enumerate(self.segments):
            if x.rigid and (x.EI is not None or x.EA is not None):
                name = "EA" if x.EI is None else "EI"
                fail(f"segments.{i}.{name}", "a number", "nothing, because the segment is rigid")
            for name in PROFILE_COLUMNS:
                given = getattr(x, name) is not None or getattr(self, name) is not None
                if not given and x.profile is None and not (x.rigid and name in ("EI", "EA")):
                    where = "a number here, in [robot] or in the column of a profile"
                    fail(f"segments.{i}.{name}", "nothing", where)
        lacking = [i for i, x in enumerate(self.segments) if self.density_of(x) is None]
        if lacking and len(lacking) < len(self.segments):
            allowed = "a number here or in [robot], because other segments have a density"
            fail(f"segments.{lacking[0]}.density", "nothing", allowed)
        total = sum(self.lengths)
        for i, point in enumerate(self.point_masses):
            if point.s > total:
                fail(f"point_masses.{i}.s", point.s, f"0 to {total:g} m, the robot's length")
        return self


def chambers_of(robot: BodyTable, actuators: tuple[ActuatorTable, ...]) -> tuple[ChamberTable, ...]:
    """Returns the air chambers of a robot, from the head to the tail."""
    return tuple(x for x in actuators if isinstance(x, ChamberTable)) or robot.own_chambers


def check_robot_actuators(robot: BodyTable, actuators: tuple[ActuatorTable, ...]) -> None:
    """Raises a validation error if the actuators do not fit the robot."""
    own = {f"robot.{x.name}_chamber": x for x in robot.own_chambers}
    if any(isinstance(x, ChamberTable) for x in actuators):
        for key, chamber in own.items():
            fail(key, list(chamber.span), "nothing, because [[actuators]] lists all chambers")
    tail, body = robot.lengths
    listed = {f"actuators.{i}.span": x for i, x in enumerate(actuators)}
    check_actuators(own | listed, body, tail + body)


def _tag_of_robot(table: Any) -> str:
    """Returns the tag of the table that describes a robot."""
    names = table if isinstance(table, dict) else getattr(type(table), "model_fields", ())
    return (SegmentedRobotTable if "segments" in names else RobotTable).tag()


AnyRobotTable = Annotated[
    Annotated[RobotTable, Tag(RobotTable.tag())]
    | Annotated[SegmentedRobotTable, Tag(SegmentedRobotTable.tag())],
    Discriminator(_tag_of_robot),
]


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
                fail(name, "nothing", 'a number, unless force_coefficients is "ramp" or "table"')
            if self.force_coefficients != "fixed" and given is not None:
                fail(name, given, 'only with force_coefficients = "fixed"; omit this key')
        given_at = [x.frequency for x in self.coefficients]
        if (self.force_coefficients == "table") != bool(given_at):
            allowed = 'at least one table if force_coefficients = "table", otherwise none'
            fail("coefficients", f"{len(given_at)} tables", allowed)
        if any(b <= a for a, b in zip(given_at, given_at[1:], strict=False)):
            fail("coefficients", given_at, "frequencies that increase from table to table")
        return self


class VortexStreetTable(Table):
    """[water.vortex_street]: two infinite rows of vortices in the stream, as in `VortexStreet`."""

    spacing: Annotated[float, Quantity(0.005, 10.0, "m")]
    circulation: Annotated[float, Quantity(-1.0, 1.0, "m^2/s")]
    core: Annotated[float, Quantity(1e-4, 1.0, "m")]
    ratio: Annotated[float, Quantity(0.05, 2.0)] = 0.281
    advection: Speed | None = None
    position: Annotated[tuple[Position, Position], FROM_LIST] = (0.0, 0.0)

    @model_validator(mode="after")
    def _speed_is_plausible(self) -> Self:
        fastest = abs(self.circulation) / (12.566 * self.core)
        if fastest > 3.0:
            allowed = "a core in which the water is at most 3 m/s fast: circulation/(4 pi core)"
            fail("core", f"{self.core:g} m ({fastest:.3g} m/s)", allowed)
        return self


class WaterTable(Table):
    """[water]: velocity (x, y) of a steady uniform stream; x points forward, y to the left.

    `vortex_street` adds vortices to the stream. `field` is the NPZ file of a velocity field.
    """

    velocity: Annotated[tuple[Speed, Speed], FROM_LIST] = (0.0, 0.0)
    field: GridFileName | None = None
    vortex_street: VortexStreetTable | None = None

    @property
    def files(self) -> list[str]:
        return [] if self.field is None else [self.field]

    @model_validator(mode="after")
    def _field_is_the_whole_velocity(self) -> Self:
        others = {"velocity": any(self.velocity), "vortex_street": self.vortex_street is not None}
        for name, given in others.items():
            if self.field is not None and given:
                fail(name, "a value", "nothing, because `field` contains the whole velocity")
        return self


class NumericsTable(Table):
    """[numerics]: nodes along the robot, longest time step, time scheme and solver tolerance."""

    nodes: Annotated[int, Field(strict=True, ge=FEWEST_NODES, le=1001)] = 51
    step: Annotated[float, Quantity(1e-5, 0.02, "s")] = 1e-3
    scheme: Literal["sdirk2", "backward_euler"] = "sdirk2"
    tolerance: Annotated[float, Quantity(1e-10, 1e-3)] = 1e-8


Ratios = Annotated[tuple[Annotated[float, Quantity(-20.0, 20.0)], ...], FROM_LIST]
Phases = Annotated[
    tuple[Annotated[float, Quantity(-1.0, 1.0, "fraction of a period")], ...], FROM_LIST
]
Biases = Annotated[tuple[Annotated[float, Quantity(-2e6, 2e6, "Pa")], ...], FROM_LIST]


class Trial(Table):
    """[[trials]]: one trial. From the first to the last chamber, the amplitude changes linearly by
    the factor `rear_ratio`, and the delay changes linearly from 0 to `phase` periods. `ratios`,
    `phases` and `biases` give each chamber its own values instead. A recorded drive contains set or
    measured pressures (`drive_is`). `effort` multiplies the amplitudes of all other actuators.

    With `support` "free", the robot swims freely. It starts straight with `start_speed` and
    `heading`. The drive runs for `lead_strides` strides before the trial's time 0."""

    file: FileName
    waveform: Literal["square", "sine", "trapezoid", "recorded"] = "square"
    frequency: Annotated[float, Quantity(0.05, 20.0, "Hz")] | None = None
    amplitude: Annotated[float, Quantity(1e3, 2e6, "Pa", or_zero=True)] | None = None
    rear_ratio: Annotated[float, Quantity(-20.0, 20.0)] = 1.0
    phase: Annotated[float, Quantity(-1.0, 1.0, "fraction of a period")] = 0.0
    ratios: Ratios | None = None
    phases: Phases | None = None
    biases: Biases | None = None
    effort: Annotated[float, Quantity(-10.0, 10.0)] = 1.0
    rise: Annotated[float, Quantity(0.001, 0.5, "fraction of a period")] = 0.1
    drive_file: FileName | None = None
    drive_is: Literal["set", "measured"] = "set"
    tow_speed: Speed = 0.0
    heave: Annotated[float, Quantity(0.0, 0.5, "m")] = 0.0
    pitch: Annotated[float, Quantity(-1.2, 1.2, "rad")] = 0.0
    pitch_phase: Annotated[float, Quantity(-6.2832, 6.2832, "rad")] = 0.0
    clamp_frequency: Annotated[float, Quantity(0.05, 20.0, "Hz")] | None = None
    support: Literal["clamped", "free"] = "clamped"
    start_speed: Speed = 0.0
    heading: Annotated[float, Quantity(-6.2832, 6.2832, "rad")] = 0.0
    roll: Annotated[float, Quantity(-6.2832, 6.2832, "rad")] = 0.0
    lead_strides: Annotated[int, Field(strict=True, ge=0, le=1000)] = 0
    duration: Annotated[float, Quantity(0.01, 600.0, "s")]
    initial: Any = None  # accepted, but not used

    @model_validator(mode="after")
    def _drive_is_complete(self) -> "Trial":
        if self.waveform == "recorded":
            if self.drive_file is None:
                fail("drive_file", "nothing", 'a CSV file, because waveform is "recorded"')
            if self.drive_file == self.file:
                fail("drive_file", repr(self.file), "a file other than the trial's `file`")
            return self
        for name, other in (("ratios", "rear_ratio"), ("phases", "phase")):
            value, default = getattr(self, other), type(self).model_fields[other].default
            if getattr(self, name) is not None and value != default:
                fail(other, value, f"nothing, because the trial has {name}")
        if self.frequency is None:
            fail("frequency", "nothing", f'a number, because waveform is "{self.waveform}"')
        if self.drive_file is not None:
            fail("drive_file", repr(self.drive_file), 'only with waveform = "recorded"')
        return self

    @model_validator(mode="after")
    def _support_is_consistent(self) -> Self:
        only = {"clamped": ("tow_speed", "heave", "pitch"), "free": ("start_speed", "heading")}
        for support, names in only.items():
            for name in names:
                if support != self.support and getattr(self, name) != 0.0:
                    fail(name, getattr(self, name), f'0, unless support is "{support}"')
        if self.lead_strides and (self.waveform == "recorded" or self.clamp_frequency is not None):
            allowed = "0 for a recorded drive, and for a clamp with its own frequency"
            fail("lead_strides", self.lead_strides, allowed)
        return self

    @property
    def lead(self) -> float:
        """Time [s] that the simulation begins before the trial's time 0."""
        return self.lead_strides / self.frequency if self.frequency else 0.0

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
    dimension: Literal[2, 3] = 2
    robot: AnyRobotTable
    parameters: ParametersTable
    sensors: SensorsTable = SensorsTable()
    water: WaterTable = WaterTable()
    numerics: NumericsTable = NumericsTable()
    actuators: Annotated[tuple[AnyActuator, ...], FROM_LIST] = ()
    effects: Annotated[tuple[EffectTable, ...], FROM_LIST] = ()
    transition: TransitionTable | None = None
    trials: Annotated[tuple[Trial, ...], FROM_LIST, Field(min_length=1)]

    @property
    def files(self) -> list[str]:
        """Names of the files that robot, water and actuators need, without those of the trials."""
        tables = (self.robot, self.water, *self.actuators)
        return sorted({name for table in tables for name in table.files})

    @property
    def chambers(self) -> tuple[ChamberTable, ...]:
        """The air chambers, from the head to the tail."""
        return chambers_of(self.robot, self.actuators)

    @property
    def chamber_names(self) -> tuple[str, ...]:
        """Names of the air chambers, from the head to the tail."""
        return tuple(x.name for x in self.chambers)

    @model_validator(mode="after")
    def _actuators_fit_the_robot(self) -> Self:
        check_robot_actuators(self.robot, self.actuators)
        for i, trial in enumerate(self.trials):
            for key in ("ratios", "phases", "biases"):
                given = getattr(trial, key)
                if given is not None and len(given) != len(self.chambers):
                    names = ", ".join(self.chamber_names) or "none"
                    allowed = f"one number for each chamber; chambers: {names}"
                    fail(f"trials.{i}.{key}", list(given), allowed)
            if trial.amplitude is None and trial.waveform != "recorded" and self.chambers:
                allowed = f'a number, because waveform is "{trial.waveform}"'
                fail(f"trials.{i}.amplitude", "nothing", allowed)
            if trial.amplitude and not self.chambers:
                fail(f"trials.{i}.amplitude", trial.amplitude, "0, as the robot has no chambers")
        return self

    @model_validator(mode="after")
    def _dimension_fits_the_tables(self) -> Self:
        if self.dimension == 2:
            for i, x in enumerate(self.actuators):
                if isinstance(x, (ChamberTable, TendonTable)) and any(x.angle):
                    given = x.angle[0] if x.angle[0] == x.angle[1] else list(x.angle)
                    fail(f"actuators.{i}.angle", given, "0, unless dimension is 3")
                if isinstance(x, ChamberTable) and x.distance is not None:
                    fail(f"actuators.{i}.distance", x.distance, "nothing, unless dimension is 3")
            for i, trial in enumerate(self.trials):
                if trial.roll != 0.0:
                    fail(f"trials.{i}.roll", trial.roll, "0, unless dimension is 3")
            return self
        for key in self.robot.lacking_in_space:
            fail(f"robot.{key}", "nothing", "a number, because dimension is 3")
        for i, actuator in enumerate(self.actuators):
            if not isinstance(actuator, (ChamberTable, TendonTable)):
                allowed = '"pneumatic" or "tendon", as dimension is 3'
                fail(f"actuators.{i}.kind", repr(actuator.kind), allowed)
            if isinstance(actuator, ChamberTable) and actuator.stiffening:
                fail(f"actuators.{i}.stiffening", actuator.stiffening, "0, as dimension is 3")
        if self.transition is not None:
            fail("transition", "a table", "nothing, because dimension is 3")
        for key in ("field", "vortex_street"):
            if getattr(self.water, key) is not None:
                fail(f"water.{key}", "a velocity field", "nothing, because dimension is 3")
        return self

    @model_validator(mode="after")
    def _steps_resolve_the_schedule(self) -> Self:
        if self.transition is not None:
            fastest = max(x.frequency for x in self.transition.schedule)
            if self.numerics.step > 0.05 / fastest:
                longest = f"{0.05 / fastest:.4g} s, a twentieth of the schedule's shortest period"
                fail("numerics.step", self.numerics.step, f"at most {longest}")
        return self

    @model_validator(mode="after")
    def _channels_fit_the_robot(self) -> Self:
        length = sum(self.robot.lengths)
        for i, x in enumerate(self.sensors.channels):
            if x.actuator is not None and x.actuator not in self.chamber_names:
                names = ", ".join(self.chamber_names) or "none"
                fail(f"sensors.channels.{i}.actuator", repr(x.actuator), f"chambers: {names}")
            if len(x.columns) > self.dimension:
                allowed = "one or two columns, unless dimension is 3"
                fail(f"sensors.channels.{i}.columns", list(x.columns), allowed)
            if x.s is not None and x.s > length * (1.0 + 1e-9):
                fail(f"sensors.channels.{i}.s", x.s, f"0 to {length:g} m, the robot's length")
        return self

    @model_validator(mode="after")
    def _trials_agree(self) -> "ExperimentTable":
        seen: dict[str, int] = {}
        for index, trial in enumerate(self.trials):
            if trial.file in seen:
                allowed = f"a unique name; trials.{seen[trial.file]} has this name"
                fail(f"trials.{index}.file", repr(trial.file), allowed)
            seen[trial.file] = index
            source = self.parameters.force_coefficients
            if source != "fixed" and trial.frequency is None:
                needed = f'a number, because parameters.force_coefficients is "{source}"'
                fail(f"trials.{index}.frequency", "nothing", needed)
            fastest = max(trial.frequency or 0.0, trial.clamp_frequency or 0.0)
            if trial.clamp_moves and not fastest:
                fail(f"trials.{index}.clamp_frequency", "nothing", "a number, as the clamp moves")
            if fastest and self.numerics.step > 0.05 / fastest:
                longest = f"{0.05 / fastest:.4g} s, a twentieth of the period of trials.{index}"
                fail("numerics.step", self.numerics.step, f"at most {longest}")
        return self
