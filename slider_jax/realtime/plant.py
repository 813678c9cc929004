"""Simulates a robot in a tank in real time, with set pressures that arrive during the simulation.

The constructor of `Plant` compiles one step of the simulator. Later calls compile nothing. Each
step calls `continued`, so effects act, and keep states, as in the simulation of a whole trial.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.actuation import FirstOrderLag, Held
from slider_jax.beam.parameters import grid_of
from slider_jax.beam.state import node_positions
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.rollout import TimeGrid, continued
from slider_jax.dynamics.step import Carry, at_rest
from slider_jax.effects import Command, Instrument, Readings, of_place
from slider_jax.effects.base import last_sample
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, to_model, to_numerics
from slider_jax.experiment.schema import Trial
from slider_jax.realtime.causality import check_commands, check_instrument
from slider_jax.realtime.faults import ChamberFaults, Faults, chamber_places, no_faults, with_fault
from slider_jax.realtime.sensors import Past, SensorReading, constant_past, read_now

PLANT_STEP = 2e-3
"""Default time step [s]."""
LOOK_BACK = 0.2
"""Time [s] for which a plant stores set pressures and readings; effects with a delay use them."""


class PlantState(eqx.Module):
    """The state that one step passes to the next step."""

    carry: Carry
    commanded: Float[Array, "samples actuators"]
    """Signed set pressures of the last steps [Pa], oldest first."""
    shared: Float[Array, " actuators"]
    """Pressure [Pa] common to the left and the right chamber; does not bend the body."""
    instruments: tuple[Past, ...]


class Plant:
    """Simulates an experiment's robot and effects in real time, in steps of `step` [s].

    The constructor compiles for about ten seconds. Afterwards, a step computes faster than real
    time. The signed pressure of a pair of chambers is left minus right. The smaller set pressure of
    a pair is common to left and right. Only the lag acts on the common pressure, which does not
    bend the body. A vented chamber has the set pressure 0. A set pressure above the limit of the
    actuator counts as the limit. Raises `InputError` if an effect needs future values.
    """

    def __init__(self, experiment: Experiment, trial: Trial | int = 0, *, step: float = PLANT_STEP):
        if not 1e-4 <= step <= 1e-2:
            raise InputError.value("step of the plant", step, "1e-4 to 1e-2 s")
        self.step = step
        self._actuators = actuators = experiment.chambers
        self.chambers = chamber_places(actuators)
        """The places of the chambers by name, in the order of set pressures and readings."""
        self._at = tuple(np.array(list(self.chambers.values()), int).reshape(-1, 2).T)
        self._limits = [actuators[row].limit or np.inf for row in self._at[0]]
        self._channels = experiment.channels
        EI_tail = float(experiment.robot_model().tail.effective_EI)
        self.faults = no_faults(len(actuators), EI_tail)
        self._faults = jax.device_put(self.faults)
        self._experiment = experiment
        self._numerics, self._scheme = to_numerics(experiment)
        self._samples = int(np.ceil(LOOK_BACK / step - 1e-9)) + 4
        self._model = self._model_of(trial)
        for effect in of_place(self._model.effects, Instrument):
            check_instrument(effect, len(actuators), step, self._samples)
        check_commands(of_place(self._model.effects, Command), step, self._samples)
        model, faults, commanded = self._model, self._faults, np.zeros(1 + 2 * len(actuators))
        self._compiled_rest = jax.jit(self._rest).lower(model, faults, commanded[0]).compile()
        state, _ = self._compiled_rest(model, faults, commanded[0])
        one_step = jax.jit(self._one_step).lower(model, faults, state, commanded)
        self._compiled_step = one_step.compile()
        self.begin(trial)
        self.advance([None] * len(self.chambers), step)
        self.begin(trial)

    def begin(self, trial: Trial | int = 0, settle: float = 0.0) -> SensorReading:
        """Resets the plant to the start of a trial and returns the reading at the start.

        The plant uses the trial's clamp motion and effects, but not the drive. All faults remain.
        The robot is straight and at rest relative to the clamp, and the chambers are empty. With
        `settle` [s], the robot is in this state `settle` earlier, with all chambers vented.
        """
        if not 0.0 <= settle < np.inf:
            raise InputError.value("settle", settle, "a finite time of 0 s or more")
        self._model = self._model_of(trial)
        self._steps_done = -round(settle / self.step)
        self._remaining = 0.0
        self.failed_at: float | None = None
        t = np.float64(self._steps_done * self.step)
        self._state, packed = self._compiled_rest(self._model, self._faults, t)
        self.reading = self._unpack(float(t), np.asarray(packed))
        return self.advance([None] * len(self.chambers), -float(t))

    def advance(
        self, set_pressures: Sequence[float | None] | np.ndarray, seconds: float
    ) -> SensorReading:
        """Simulates `seconds` [s] with set gauge pressures [Pa] and returns the last reading.

        The chambers are in the order of `chambers`; None vents a chamber. Time advances in whole
        steps. A step uses the set pressures of the call that completes the step. Time shorter than
        a step is kept for the next call. If a step does not converge, the plant
        stops until the next `begin`, returns readings with `ok` false, and sets `failed_at` [s].
        Raises `InputError` for a pressure that is negative or not finite.
        """
        commanded = np.concatenate([[0.0], self._checked(set_pressures)])
        self._remaining += seconds
        steps = int(np.floor(self._remaining / self.step + 1e-6))
        self._remaining -= steps * self.step
        for _ in range(steps):
            if self.failed_at is not None:
                break
            commanded[0] = self._steps_done * self.step
            self._state, packed = self._compiled_step(
                self._model, self._faults, self._state, commanded
            )
            self._steps_done += 1
            after = self._unpack(self._steps_done * self.step, np.asarray(packed))
            if after.ok:
                self.reading = after
            else:
                self.failed_at = after.t
                self.reading = self.reading._replace(ok=False)
        return self.reading

    def inject(self, name: str, value: float) -> None:
        """Sets a fault from the next step on. The value of an intact robot removes the fault.

        `leak_CHAMBER` [1/s] is the leak's conductance divided by the capacity of the chamber.
        `blocked_CHAMBER` is the blocked fraction, 0 to 1, of the fill valve's flow. CHAMBER is the
        name of a chamber, such as `front_left`. `EI_tail` is the tail's bending stiffness [N m^2].
        """
        self.faults = with_fault(self.faults, self.chambers, name, value)
        self._faults = jax.device_put(self.faults)

    def _model_of(self, trial: Trial | int) -> Model:
        if isinstance(trial, int):
            trial = self._experiment.trials[trial]
        idle = {"waveform": "square", "frequency": trial.frequency or 1.0, "amplitude": 0.0}
        return to_model(self._experiment, trial.model_copy(update=idle | {"biases": None}))

    def _checked(self, set_pressures: Sequence[float | None] | np.ndarray) -> np.ndarray:
        """Returns the set pressures (left and right of each actuator), 0 for missing chambers."""
        given = np.array([0.0 if p is None else p for p in set_pressures], float)
        count = len(self.chambers)
        if given.shape != (count,):
            allowed = f"{count}, one for each chamber: {', '.join(self.chambers)}"
            raise InputError.value("set pressures", f"{given.size} values", allowed)
        for chamber, p in zip(self.chambers, given.tolist(), strict=True):
            if not 0.0 <= p < np.inf:
                allowed = "0 or more [Pa, gauge], or None to vent"
                raise InputError.value(f"set pressure of {chamber}", p, allowed)
        commanded = np.zeros((len(self.faults.leak), 2))
        commanded[self._at] = np.minimum(given, self._limits)
        return commanded.ravel()

    def _unpack(self, t: float, packed: np.ndarray) -> SensorReading:
        count = len(self.faults.leak)
        signed, (thrust, recoil, tip) = packed[:count].tolist(), packed[count : count + 3].tolist()
        shared, ok = packed[count + 3 : -1].tolist(), bool(packed[-1] > 0.5)
        pressures = []
        for row, column in self.chambers.values():
            p = -signed[row] if column else signed[row]
            pair = self._actuators[row].side == "both"
            pressures.append(max(p, 0.0) + shared[row] if pair else p)
        return SensorReading(t, tuple(pressures), tuple(signed), thrust, recoil, tip, ok)

    def _rest(self, model: Model, faults: Faults, t: Array) -> tuple[PlantState, Array]:
        carry = at_rest(_with_faults(model, faults), self._numerics, t)
        grid = grid_of(model.body, self._numerics)
        line = node_positions(carry.memory.motion[2], carry.memory.strain, carry.memory.head, grid)
        zero = jnp.zeros(())
        read = Readings(t, jnp.zeros(len(faults.leak)), zero, zero, line[1, 0])
        pasts = []
        for effect in of_place(model.effects, Instrument):
            pasts.append(constant_past(effect, read, self.step, self._samples))
            read = last_sample(pasts[-1].read)
        commanded = jnp.zeros((self._samples, len(faults.leak)))
        state = PlantState(carry, commanded, jnp.zeros(len(faults.leak)), tuple(pasts))
        return state, _pack(read, state)

    def _one_step(
        self, model: Model, faults: Faults, state: PlantState, time_and_commanded: Array
    ) -> tuple[PlantState, Array]:
        t, (left, right) = time_and_commanded[0], time_and_commanded[1:].reshape(-1, 2).T
        commanded = jnp.concatenate([state.commanded[1:], (left - right)[None]])
        times = t + self.step * jnp.arange(1.0 - self._samples, 1.0)
        drive = Drive(tuple(Held(times, x) for x in commanded.T))
        driven = eqx.tree_at(lambda m: m.drive, _with_faults(model, faults), drive)
        grid = TimeGrid(self.step, 1, t)
        observe = self._channels.observe
        run = continued(state.carry, driven, grid, observe, self._numerics, self._scheme)
        read = last_sample(self._channels.readings(run.t, run.saved))
        pasts, instruments = [], of_place(model.effects, Instrument)
        for effect, past in zip(instruments, state.instruments, strict=True):
            read, past = read_now(effect, past, read)
            pasts.append(past)
        assert isinstance(model.pressure_law, FirstOrderLag)
        lower = jnp.minimum(left, right)
        shared = lower + (state.shared - lower) * jnp.exp(
            -self.step / model.pressure_law.time_constants
        )
        after = PlantState(run.final, commanded, shared, tuple(pasts))
        return after, _pack(read, after)


def _with_faults(model: Model, faults: Faults) -> Model:
    robot = model.robot.with_tail(EI=jnp.asarray(faults.EI_tail))
    effects = (*model.effects, ChamberFaults(*map(jnp.asarray, faults[:2])))
    return eqx.tree_at(lambda m: (m.robot, m.effects), model, (robot, effects))


def _pack(read: Readings, state: PlantState) -> Float[Array, " values"]:
    """Returns readings, common pressures and `ok` as one array, so a step copies only one array."""
    values = jnp.stack([*read.pressures, *read[2:], *state.shared])
    ok = state.carry.ok & jnp.all(jnp.isfinite(values))
    return jnp.concatenate([values, ok.astype(values.dtype)[None]])
