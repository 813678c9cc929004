"""A robot in its tank that runs as it is driven: set pressures come as they come.

One step of the simulator is compiled when the plant is made; nothing is traced afterwards. Effects
act as in `rollout`, which takes each step: those that remember keep what they need.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slider_jax.actuation import FirstOrderLag, Held
from slider_jax.beam.parameters import grid_of
from slider_jax.beam.state import node_positions
from slider_jax.channels import BUILT_IN, readings
from slider_jax.dynamics.model import Drive, Model
from slider_jax.dynamics.rollout import TimeGrid, rollout
from slider_jax.dynamics.step import Carry, at_rest
from slider_jax.effects import Command, Instrument, Readings, of_place
from slider_jax.errors import InputError
from slider_jax.experiment.load import Experiment, to_model, to_numerics
from slider_jax.experiment.schema import Trial
from slider_jax.realtime.commands import check_commands
from slider_jax.realtime.faults import CHAMBERS, ChamberFaults, Faults, no_faults, with_fault
from slider_jax.realtime.sensors import Past, check_instrument, constant_past, read_now

STEP = 2e-3
"""[s]"""
LOOK_BACK = 0.2
"""[s] of set pressures and of readings that are kept for what acts late."""


class SensorReading(NamedTuple):
    """What the sensors read at `t` [s], without noise. `SensorNoise` adds that."""

    t: float
    pressures: tuple[float, float, float, float]
    """Of the four chambers, gauge [Pa]: front left, front right, rear left, rear right."""
    p_front: float
    """Left less right [Pa], as in the model and its columns."""
    p_rear: float
    thrust_N: float
    recoil_N: float
    tip_m: float
    ok: bool
    """False once a step has failed: the reading is then the last good one."""


class PlantState(eqx.Module):
    """What one step hands to the next."""

    carry: Carry
    asked: Float[Array, "samples 2"]
    """Signed set pressures of the last steps, oldest first."""
    shared: Float[Array, "2"]
    """What both chambers of a segment hold, which does not bend it [Pa]."""
    instruments: tuple[Past, ...]


class Plant:
    """The robot of an experiment, with its effects, as one that is driven sample by sample.

    Steps are `step` [s] long, the mesh is the experiment's. Made in some ten seconds, for the
    compiler; a step then takes a fraction of its length. A segment's signed pressure is the
    model's: where it is positive the left chamber holds it, where negative the right one. What
    both are asked to hold beside it follows with the lag alone and bends nothing. A vented chamber
    has the set pressure 0.

    Raises `InputError` where an effect needs to know what is still to come.
    """

    def __init__(self, experiment: Experiment, trial: Trial | int = 0, *, step: float = STEP):
        if not 1e-4 <= step <= 1e-2:
            raise InputError.value("step of the plant", step, "1e-4 to 1e-2 s")
        self.step = step
        self.faults = no_faults(experiment.robot.EI_tail)
        self._faults = jax.device_put(self.faults)
        self._experiment = experiment
        self._numerics, self._scheme = to_numerics(experiment)
        self._samples = int(np.ceil(LOOK_BACK / step - 1e-9)) + 4
        self._model = self._model_of(trial)
        self._check()
        model, faults, asked = self._model, self._faults, np.zeros(5)
        self._compiled_rest = jax.jit(self._rest).lower(model, faults, asked[0]).compile()
        state, _ = self._compiled_rest(model, faults, asked[0])
        self._compiled_step = jax.jit(self._one_step).lower(model, faults, state, asked).compile()
        self.begin(trial)
        self.advance([None] * 4, step)
        self.begin(trial)

    def begin(self, trial: Trial | int = 0, settle: float = 0.0) -> SensorReading:
        """Back to the start of a trial: its clamp's motion, and its share in the effects.

        The robot is straight and at rest relative to the clamp, the chambers empty; with `settle`
        [s] it was so that long before the start, and vented since. The trial's drive is not used.
        Faults stay.
        """
        if not 0.0 <= settle < np.inf:
            raise InputError.value("settle", settle, "0 or more seconds")
        self._model = self._model_of(trial)
        self._done = -round(settle / self.step)
        self._owed = 0.0
        self.failed_at: float | None = None
        t = np.float64(self._done * self.step)
        self._state, packed = self._compiled_rest(self._model, self._faults, t)
        self.reading = _unpack(float(t), np.asarray(packed))
        return self.advance([None] * 4, -float(t))

    def advance(
        self, set_pressures: Sequence[float | None] | np.ndarray, seconds: float
    ) -> SensorReading:
        """Run `seconds` [s] under set gauge pressures [Pa], None of a vented chamber.

        The chambers are those of `SensorReading.pressures`. Time goes in whole steps, with the set
        pressures of the call that completes one; what is left over is kept for the next call.
        A step that does not converge stops the plant until `begin`: readings say so by `ok`, and
        `failed_at` is the time [s] of that step. Raises `InputError` for a pressure that is
        negative or not a number.
        """
        asked = np.concatenate([[0.0], _checked(set_pressures)])
        self._owed += seconds
        steps = int(np.floor(self._owed / self.step + 1e-6))
        self._owed -= steps * self.step
        for _ in range(steps):
            if self.failed_at is not None:
                break
            asked[0] = self._done * self.step
            self._state, packed = self._compiled_step(self._model, self._faults, self._state, asked)
            self._done += 1
            after = _unpack(self._done * self.step, np.asarray(packed))
            if after.ok:
                self.reading = after
            else:
                self.failed_at = after.t
                self.reading = self.reading._replace(ok=False)
        return self.reading

    def inject(self, name: str, value: float) -> None:
        """Set a fault, from the next step on: its sound value mends it.

        `leak_front_left` [1/s], conductance over capacity; `blocked_front_left`, share from 0 to 1
        of the fill valve's flow that is missing; so for all chambers; `EI_tail` [N m^2].
        """
        self.faults = with_fault(self.faults, name, value)
        self._faults = jax.device_put(self.faults)

    def _model_of(self, trial: Trial | int) -> Model:
        if isinstance(trial, int):
            trial = self._experiment.trials[trial]
        idle = {"waveform": "square", "frequency": trial.frequency or 1.0, "amplitude": 0.0}
        return to_model(self._experiment, trial.model_copy(update=idle))

    def _check(self) -> None:
        for effect in of_place(self._model.effects, Instrument):
            check_instrument(effect, self.step, self._samples)
        check_commands(of_place(self._model.effects, Command), self.step, self._samples)

    def _rest(self, model: Model, faults: Faults, t: Array) -> tuple[PlantState, Array]:
        carry = at_rest(_faulty(model, faults), self._numerics, t)
        grid = grid_of(model.body, self._numerics)
        line = node_positions(carry.memory.motion[2], carry.memory.strain, carry.memory.head, grid)
        zero = jnp.zeros(())
        read = Readings(t, zero, zero, zero, zero, line[1, 0])
        pasts = []
        for effect in of_place(model.effects, Instrument):
            pasts.append(constant_past(effect, read, self.step, self._samples))
            read = jax.tree.map(lambda x: x[-1], pasts[-1].read)
        state = PlantState(carry, jnp.zeros((self._samples, 2)), jnp.zeros(2), tuple(pasts))
        return state, _pack(read, state)

    def _one_step(
        self, model: Model, faults: Faults, state: PlantState, asked_at: Array
    ) -> tuple[PlantState, Array]:
        t, (left, right) = asked_at[0], asked_at[1:].reshape(2, 2).T
        asked = jnp.concatenate([state.asked[1:], (left - right)[None]])
        times = t + self.step * jnp.arange(1.0 - self._samples, 1.0)
        drive = Drive(Held(times, asked[:, 0]), Held(times, asked[:, 1]))
        driven = eqx.tree_at(lambda m: m.drive, _faulty(model, faults), drive)
        run = rollout(
            driven,
            TimeGrid(self.step, 1, t),
            readings,
            self._numerics,
            self._scheme,
            begin=state.carry,
            checkpoint=False,
        )
        now = jax.tree.map(lambda x: x[0], run.saved)
        read = Readings(run.t[0], *(now[name] for name in BUILT_IN))
        pasts = []
        instruments = of_place(model.effects, Instrument)
        for effect, past in zip(instruments, state.instruments, strict=True):
            read, past = read_now(effect, past, read)
            pasts.append(past)
        assert isinstance(model.pressure_law, FirstOrderLag)
        least = jnp.minimum(left, right)
        shared = least + (state.shared - least) * jnp.exp(-self.step / model.pressure_law.k)
        after = PlantState(run.final, asked, shared, tuple(pasts))
        return after, _pack(read, after)


def _faulty(model: Model, faults: Faults) -> Model:
    robot = eqx.tree_at(lambda r: r.EI_tail, model.robot, faults.EI_tail)
    effects = (*model.effects, ChamberFaults(*map(jnp.asarray, faults[:2])))
    return eqx.tree_at(lambda m: (m.robot, m.effects), model, (robot, effects))


def _pack(read: Readings, state: PlantState) -> Float[Array, "8"]:
    """All that leaves the device, in one array."""
    values = jnp.stack([*read[1:], *state.shared])
    ok = state.carry.ok & jnp.all(jnp.isfinite(values))
    return jnp.concatenate([values, ok.astype(values.dtype)[None]])


def _unpack(t: float, packed: np.ndarray) -> SensorReading:
    front, rear, thrust, recoil, tip, *shared, ok = packed.tolist()
    pressures = (
        max(front, 0.0) + shared[0],
        max(-front, 0.0) + shared[0],
        max(rear, 0.0) + shared[1],
        max(-rear, 0.0) + shared[1],
    )
    return SensorReading(t, pressures, front, rear, thrust, recoil, tip, ok > 0.5)


def _checked(set_pressures: Sequence[float | None] | np.ndarray) -> np.ndarray:
    asked = np.array([0.0 if p is None else p for p in set_pressures], float)
    if asked.shape != (4,):
        raise InputError.value("set pressures", f"{asked.size} of them", "one for each chamber, 4")
    for chamber, p in zip(CHAMBERS, asked.tolist(), strict=True):
        if not 0.0 <= p < np.inf:
            raise InputError.value(
                f"set pressure of {chamber}", p, "0 or more [Pa, gauge], or None to vent"
            )
    return asked
