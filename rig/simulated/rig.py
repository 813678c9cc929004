"""Simulates a manifold with a tank in device time, including faults of the serial line."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

from rig.simulated.manifold import ManifoldCore
from rig.simulated.tank import Tank, TankState

SetPoint = tuple[int, ...] | None
"""Set pressures (chambers,) [Pa] that the valves follow; None while all chambers vent."""
STEP = 1_000
"""Time step of the tank and of the manifold's main loop [us]."""
TIP_PER_VOLT = 0.1
"""Scale of the tip's sensor at the first analogue input [m/V]."""
STALL = 20_000
"""After a pause of this program that is longer than this time [us], bytes that arrived meanwhile
act at this time after the pause's start. They restart the watchdog at the end of the pause."""


@dataclass(frozen=True)
class LineFaults:
    """Faults of line and sensors. `flipped`, `dropped` and `inserted` are fractions of the bytes in
    each direction. Times are times since the first tick [s]."""

    flipped: float = 0.0
    dropped: float = 0.0
    inserted: float = 0.0
    reset_at: float | None = None
    """Time at which the manifold resets."""
    silent: tuple[float, float] | None = None
    """Start and end of a silence [s]. The delayed bytes are sent at the end of the silence."""
    stuck: tuple[int, float] | None = None
    """Index of a channel, and the time from which its reading is constant."""
    noise: float = 0.0
    """Standard deviation of the chambers' pressure readings [Pa]."""
    tip_noise: float = 0.0
    """Standard deviation of the tip's position [m]."""
    seed: int = 0


@dataclass
class FaultyLine:
    """A line that damages bytes according to `faults` and counts the damaged bytes."""

    faults: LineFaults
    damaged: int = 0
    _random: Random = field(init=False)

    def __post_init__(self) -> None:
        self._random = Random(self.faults.seed)

    def damage(self, piece: bytes) -> bytes:
        """Returns the bytes that arrive if `piece` is sent."""
        faults = self.faults
        share = faults.flipped + faults.dropped + faults.inserted
        if not share or not piece:
            return piece
        arrived = bytearray()
        for byte in piece:
            chance = self._random.random()
            if chance >= share:
                arrived.append(byte)
                continue
            self.damaged += 1
            if chance < faults.flipped:
                arrived.append(byte ^ (1 << self._random.randrange(8)))
            elif chance < faults.flipped + faults.inserted:
                arrived += bytes([self._random.randrange(256), byte])
        return bytes(arrived)


class SimulatedRig:
    """A simulated manifold that exchanges bytes with the host, and the chambers of a tank.

    Set pressures act when they arrive: each time step of the tank uses their mean in this step.
    """

    def __init__(
        self,
        tank: Tank,
        core: ManifoldCore | None = None,
        faults: LineFaults = LineFaults(),
        new_core: Callable[[], ManifoldCore] = ManifoldCore,
    ):
        self.core, self.tank, self.faults = core or new_core(), tank, faults
        self._new_core = new_core
        self._in, self._out, self._random = (
            FaultyLine(faults),
            FaultyLine(faults),
            Random(faults.seed),
        )
        self._start: int | None = None
        self._at, self._reset, self._held = 0, False, b""
        self._stuck: int | None = None
        self._states: deque[tuple[int, TankState]] = deque(maxlen=256)
        self._followed: list[tuple[int, SetPoint]] = []

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Takes bytes from the host and returns the answer."""
        at = min(now_us, self._at + STALL)
        sent = self.core.feed(self._in.damage(piece), at)
        if at < now_us:
            self.core.delay_last_command(now_us, at)
        self._followed.append((at, self.core.set_pressures))
        return self._delayed(self._out.damage(sent), now_us)

    def tick(self, now_us: int) -> bytes:
        """Advances to `now_us` and returns the bytes sent meanwhile."""
        if self._start is None:
            self._start = self._at = now_us
            self._followed.insert(0, (now_us, None))
            self._states.append((now_us, self.tank.advance(None, STEP * 1e-6)))
        sent = b""
        while self._at <= now_us:
            since = (self._at - self._start) * 1e-6
            before = self.core.set_pressures
            if self.faults.reset_at is not None and since >= self.faults.reset_at:
                if not self._reset:
                    self.core, self._reset = self._new_core(), True
            if self._at > self._start:
                now = self.tank.advance(self._mean_set(), STEP * 1e-6)
                self._states.append((self._at, now))
            sent += self.core.tick(self._at, self._channels(self._states[-1][1], since))
            if self.core.set_pressures != before:
                self._followed = [(self._at, self.core.set_pressures)]
            self._at += STEP
        return self._delayed(self._out.damage(sent), now_us)

    @property
    def reached_us(self) -> int:
        """Latest device time with a known state of the tank [us]."""
        return self._states[-1][0] if self._states else 0

    def state_at(self, now_us: int) -> TankState:
        """Returns the tank's true state at a time within the last 0.25 s.

        The state is interpolated linearly between steps, and extrapolated by at most one step.
        """
        states = list(self._states)
        if not states:
            return TankState((0.0,) * self.core.chambers, 0.0, 0.0, 0.0, 0.0)
        after = next((i for i in range(len(states) - 1, 0, -1) if states[i - 1][0] <= now_us), 0)
        if after == 0:
            return states[0][1]
        (t0, a), (t1, b) = states[after - 1], states[after]
        share = min((now_us - t0) / (t1 - t0), 2.0)

        def between(x: float, y: float) -> float:
            return x + share * (y - x)

        p = tuple(between(x, y) for x, y in zip(a.chambers, b.chambers, strict=True))
        rest = (between(x, y) for x, y in zip(a[1:], b[1:], strict=True))
        return TankState(p, *rest)

    def _mean_set(self) -> SetPoint:
        """Returns the mean set pressures in the step that ends now. Keeps later changes."""
        start, end = self._at - STEP, self._at
        times = [max(at, start) for at, _ in self._followed if at < end]
        sets = [x for at, x in self._followed if at < end]
        last = sets[-1]
        self._followed = [(end, last), *(x for x in self._followed if x[0] >= end)]
        if all(x is None for x in sets):
            return None
        if all(x == last for x in sets):
            return last
        held = [b - a for a, b in zip(times, [*times[1:], end], strict=True)]
        zero = (0,) * self.core.chambers
        total = [0.0] * self.core.chambers
        for seconds, x in zip(held, sets, strict=True):
            total = [p + seconds / STEP * q for p, q in zip(total, x or zero, strict=True)]
        return tuple(round(p) for p in total)

    def _channels(self, state: TankState, since: float) -> tuple[int, ...]:
        noise = self.faults.noise
        chambers = [p + self._random.gauss(0.0, noise) if noise else p for p in state.chambers]
        tip_noise = self.faults.tip_noise
        position = state.tip + (self._random.gauss(0.0, tip_noise) if tip_noise else 0.0)
        tip = round(1e6 * position / TIP_PER_VOLT)
        channels = [*(round(p) for p in chambers), round(state.supply), tip, 0, 0]
        stuck = self.faults.stuck
        if stuck is not None and since >= stuck[1]:
            self._stuck = channels[stuck[0]] if self._stuck is None else self._stuck
            channels[stuck[0]] = self._stuck
        return tuple(channels)

    def _delayed(self, sent: bytes, now_us: int) -> bytes:
        silent, start = self.faults.silent, self._start or now_us
        if silent is not None and silent[0] <= (now_us - start) * 1e-6 < silent[1]:
            self._held += sent
            return b""
        sent, self._held = self._held + sent, b""
        return sent
