"""A simulated manifold with what it drives, in the device's time."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

from rig.simulated.manifold import ManifoldCore
from rig.simulated.tank import Tank, TankState

Set = tuple[int, ...] | None
STEP = 1_000
"""Of the tank, and of the main loop [us]."""
TIP_PER_VOLT = 0.1
"""Of the sensor of the tip, on the first analogue input [m/V]."""
STALL = 20_000
"""Of a program that was not run for longer, what came meanwhile acts so soon after it stood still
[us]. For the watchdog it came last of all, for it may have."""


@dataclass(frozen=True)
class LineFaults:
    """Shares of bytes flipped, dropped and inserted, either way; and what happens at times [s]."""

    flipped: float = 0.0
    dropped: float = 0.0
    inserted: float = 0.0
    reset_at: float | None = None
    """The manifold starts anew."""
    silent: tuple[float, float] | None = None
    """From when to when it sends nothing; all of it comes at the end, late."""
    stuck: tuple[int, float] | None = None
    """A channel, and from when it reads the same."""
    noise: float = 0.0
    """Standard deviation of the chambers' pressures [Pa]."""
    tip_noise: float = 0.0
    """Of the tip's place [m]."""
    seed: int = 0


@dataclass
class FaultyLine:
    """Damages bytes as a `LineFaults` says, and counts how many it touched."""

    faults: LineFaults
    touched: int = 0
    _random: Random = field(init=False)

    def __post_init__(self) -> None:
        self._random = Random(self.faults.seed)

    def damage(self, piece: bytes) -> bytes:
        """What arrives of a piece."""
        m = self.faults
        share = m.flipped + m.dropped + m.inserted
        if not share or not piece:
            return piece
        arrived = bytearray()
        for byte in piece:
            chance = self._random.random()
            if chance >= share:
                arrived.append(byte)
                continue
            self.touched += 1
            if chance < m.flipped:
                arrived.append(byte ^ (1 << self._random.randrange(8)))
            elif chance < m.flipped + m.inserted:
                arrived += bytes([self._random.randrange(256), byte])
        return bytes(arrived)


class SimulatedRig:
    """Bytes in and out of a manifold whose chambers are those of a tank.

    Set pressures act from when they come: a step has their mean over it.
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
        self._begun: int | None = None
        self._at, self._reset, self._held = 0, False, b""
        self._stuck: int | None = None
        self._states: deque[tuple[int, TankState]] = deque(maxlen=256)
        self._followed: list[tuple[int, Set]] = []

    def feed(self, piece: bytes, now_us: int) -> bytes:
        """Takes bytes from the host; returns what is said to them."""
        at = min(now_us, self._at + STALL)
        said = self.core.feed(self._in.damage(piece), at)
        if at < now_us:
            self.core.came_until(now_us, at)
        self._followed.append((at, self.core.set_pressures))
        return self._late(self._out.damage(said), now_us)

    def tick(self, now_us: int) -> bytes:
        """Goes on to `now_us`; returns what is said meanwhile."""
        if self._begun is None:
            self._begun = self._at = now_us
            self._followed.insert(0, (now_us, None))
            self._states.append((now_us, self.tank.advance(None, STEP * 1e-6)))
        said = b""
        while self._at <= now_us:
            since = (self._at - self._begun) * 1e-6
            before = self.core.set_pressures
            if self.faults.reset_at is not None and since >= self.faults.reset_at:
                if not self._reset:
                    self.core, self._reset = self._new_core(), True
            if self._at > self._begun:
                now = self.tank.advance(self._mean_set(), STEP * 1e-6)
                self._states.append((self._at, now))
            said += self.core.tick(self._at, self._channels(self._states[-1][1], since))
            if self.core.set_pressures != before:
                self._followed = [(self._at, self.core.set_pressures)]
            self._at += STEP
        return self._late(self._out.damage(said), now_us)

    @property
    def reached_us(self) -> int:
        """Up to when the tank's state is known."""
        return self._states[-1][0] if self._states else 0

    def measured(self, now_us: int) -> TankState:
        """The tank's true values at a time within the last quarter of a second.

        Linear between its steps, and beyond the last one for no longer than one.
        """
        states = list(self._states)
        if not states:
            return TankState((0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0)
        after = next((i for i in range(len(states) - 1, 0, -1) if states[i - 1][0] <= now_us), 0)
        if after == 0:
            return states[0][1]
        (t0, a), (t1, b) = states[after - 1], states[after]
        share = min((now_us - t0) / (t1 - t0), 2.0)

        def between(x: float, y: float) -> float:
            return x + share * (y - x)

        p = [between(x, y) for x, y in zip(a.chambers, b.chambers, strict=True)]
        rest = (between(x, y) for x, y in zip(a[1:], b[1:], strict=True))
        return TankState((p[0], p[1], p[2], p[3]), *rest)

    def _mean_set(self) -> Set:
        """Over the step that ends at the tank's time; what holds then and comes later is kept."""
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
        total = [0.0] * 4
        for seconds, x in zip(held, sets, strict=True):
            total = [p + seconds / STEP * q for p, q in zip(total, x or (0, 0, 0, 0), strict=True)]
        a, b, c, d = (round(p) for p in total)
        return a, b, c, d

    def _channels(self, state: TankState, since: float) -> tuple[int, ...]:
        noise = self.faults.noise
        chambers = [p + self._random.gauss(0.0, noise) if noise else p for p in state.chambers]
        shaken = self.faults.tip_noise
        place = state.tip + (self._random.gauss(0.0, shaken) if shaken else 0.0)
        tip = round(1e6 * place / TIP_PER_VOLT)
        channels = [*(round(p) for p in chambers), round(state.supply), tip, 0, 0]
        stuck = self.faults.stuck
        if stuck is not None and since >= stuck[1]:
            self._stuck = channels[stuck[0]] if self._stuck is None else self._stuck
            channels[stuck[0]] = self._stuck
        return tuple(channels)

    def _late(self, said: bytes, now_us: int) -> bytes:
        silent, begun = self.faults.silent, self._begun or now_us
        if silent is not None and silent[0] <= (now_us - begun) * 1e-6 < silent[1]:
            self._held += said
            return b""
        said, self._held = self._held + said, b""
        return said
