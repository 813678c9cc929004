"""Is the rig fit for a trial: rate, line, answer times, noise, how each chamber holds; forces."""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rig.errors import RigError
from rig.force.sensor import ForceSource, SensorMounting
from rig.manifold.driver import Manifold
from rig.protocol.messages import CHAMBERS, Reading

ANSWER = 0.02
"""Longest that a command's reading is waited for [s]: several may be lost before the watchdog."""
HOLD = 1.5
"""How long a chamber is held [s]."""
COMMANDS = 50
"""Whose answers are timed."""
LEAST_HELD = 0.95
"""Share of a set pressure that a chamber without a leak comes to."""
RESOLVED = 0.9
"""Share of the announced readings that has to come."""
FORCE_RATE = 1000.0
"""Records a second of a force sensor, of which `RESOLVED` have to come."""


class ChamberCheck(NamedTuple):
    """One chamber at a set pressure."""

    name: str
    asked: float
    """[Pa]"""
    reached: float
    """Mean over the last fifth of the hold [Pa]."""
    rise: float
    """Time to 63 % of what was reached [s]."""
    others: float
    """Largest pressure that another chamber came to meanwhile [Pa]."""


class ManifoldCheck(NamedTuple):
    """What was found."""

    rate: float
    """Readings a second that came."""
    lost: int
    damaged: int
    round_trip: np.ndarray
    """(n,) from a command to the first reading that tells of it [s]."""
    noise: np.ndarray
    """(8,) standard deviations at rest, in the channels' units."""
    offset: np.ndarray
    """(8,) means at rest."""
    held: list[ChamberCheck]
    findings: list[str]


class ForceCheck(NamedTuple):
    """What was found of a force sensor at rest."""

    rate: float
    """Records a second that came."""
    lost: int
    offset: np.ndarray
    """(2,) means of thrust and recoil [N]."""
    noise: np.ndarray
    """(2,) standard deviations [N]."""
    findings: list[str]


class ReadingCollector:
    """Readings with their times of arrival, from the reader's thread."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, Reading]] = []

    def __call__(self, host_ns: int, reading: Reading) -> None:
        self.rows.append((host_ns, reading))

    def take(self) -> list[tuple[int, Reading]]:
        """What has come since the last time."""
        rows = self.rows[: len(self.rows)]
        del self.rows[: len(rows)]
        return rows


def check_manifold(
    manifold: Manifold,
    collector: ReadingCollector,
    pressure: float,
    say: Callable[[str], None] = lambda text: None,
) -> ManifoldCheck:
    """A check with each chamber in turn at `pressure` [Pa]; the limits are set already.

    `collector` is what the manifold gives its readings to. Raises `RigError`.
    """
    assert manifold.ident is not None
    say("at rest")
    collector.take()
    begun = time.monotonic()
    _hold(manifold, 2.0, lambda: None)
    seconds, quiet = time.monotonic() - begun, collector.take()
    if len(quiet) < 2:
        raise RigError("no readings come; check the line from the manifold to the computer")
    channels = np.array([r.channels for _, r in quiet], float)
    rate = len(quiet) / seconds
    manifold.arm()
    say("answer times")
    trips = _round_trips(manifold, collector)
    held = []
    for chamber, name in enumerate(CHAMBERS):
        say(f"{name} at {1e-3 * pressure:g} kPa")
        held.append(_held(manifold, collector, chamber, pressure))
    manifold.stop()
    findings = [
        f"{x.name} reads {1e-3 * x.reached:.1f} kPa where {1e-3 * x.asked:.1f} are set: a leak, a "
        "blocked valve, or the supply is too low"
        for x in held
        if x.reached < LEAST_HELD * x.asked
    ] + [
        f"with {x.name} alone set, another chamber reads {1e-3 * x.others:.1f} kPa: lines crossed, "
        "or a vent that does not open"
        for x in held
        if x.others > 0.2 * x.asked
    ]
    if rate < RESOLVED * manifold.ident.rate:
        findings.append(f"{rate:.0f} readings a second come, {manifold.ident.rate} are announced")
    if len(trips) < COMMANDS:
        findings.append(
            f"{COMMANDS - len(trips)} of {COMMANDS} commands were not told of within "
            f"{1e3 * ANSWER:g} ms: lost on the line, or the computer is too busy"
        )
    if manifold.lost or manifold.damaged:
        findings.append(f"{manifold.lost} readings lost, {manifold.damaged} frames damaged")
    noise, offset = channels.std(axis=0), channels.mean(axis=0)
    return ManifoldCheck(
        rate, manifold.lost, manifold.damaged, trips, noise, offset, held, findings
    )


def check_force(source: ForceSource, mounting: SensorMounting, seconds: float = 1.0) -> ForceCheck:
    """Listens to a force sensor for so long; nothing moves. Raises `RigError` if it is silent."""
    came: list[tuple[int, bytes]] = []
    source.start(lambda host_ns, piece: came.append((host_ns, piece)))
    try:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            time.sleep(0.05)
            source.check()
        lost = source.health().missing
    finally:
        source.stop()
    forces = source.calibration.forces([t for t, _ in came], [piece for _, piece in came])
    came_through = np.isfinite(forces.wrench).all(axis=1)  # the lost are NaN
    sound = forces.wrench[came_through & ~forces.doubtful]
    if len(sound) < 2:
        raise RigError("the force sensor gives no sound record; see to its cable and its load")
    span = 1e-9 * float(forces.t_ns[-1] - forces.t_ns[0])
    rate = (int(came_through.sum()) - 1) / max(span, 1e-9)
    findings = list(forces.findings)
    if rate < RESOLVED * FORCE_RATE:
        findings.append(
            f"{rate:.0f} records of force a second come; set its RDT rate to {FORCE_RATE:g}"
        )
    values = np.stack(mounting.thrust_and_recoil(sound))
    return ForceCheck(rate, lost, values.mean(axis=1), values.std(axis=1), findings)


def _hold(manifold: Manifold, seconds: float, command: Callable[[], object]) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        command()
        manifold.check()
        time.sleep(0.01)


def _round_trips(manifold: Manifold, collector: ReadingCollector) -> np.ndarray:
    trips = []
    for _ in range(COMMANDS):
        collector.take()
        begun, seq = time.monotonic_ns(), manifold.set((0.0, 0.0, 0.0, 0.0))
        end = time.monotonic() + ANSWER
        while time.monotonic() < end:
            came = next((t for t, r in list(collector.rows) if r.command == seq), None)
            if came is not None:
                trips.append(1e-9 * (came - begun))
                break
            time.sleep(0.0005)
        manifold.check()
    return np.array(trips)


def _held(
    manifold: Manifold, collector: ReadingCollector, chamber: int, pressure: float
) -> ChamberCheck:
    pressures = [pressure if i == chamber else 0.0 for i in range(len(CHAMBERS))]
    collector.take()
    begun = time.monotonic_ns()
    _hold(manifold, HOLD, lambda: manifold.set(pressures))
    rows = collector.take()
    t = np.array([1e-9 * (host_ns - begun) for host_ns, _ in rows])
    p = np.array([r.channels[:4] for _, r in rows], float)
    if not (t > 0.8 * HOLD).any():
        raise RigError(f"no readings came while {CHAMBERS[chamber]} was held; check the line")
    reached = float(p[t > 0.8 * HOLD, chamber].mean())
    above = np.flatnonzero(p[:, chamber] >= 0.632 * reached)
    rise = float(t[above[0]]) if len(above) else float("nan")
    others = float(np.delete(p, chamber, axis=1)[t > 0.8 * HOLD].max())
    _hold(manifold, 0.5, lambda: manifold.set((0.0, 0.0, 0.0, 0.0)))
    return ChamberCheck(CHAMBERS[chamber], pressure, reached, rise, others)
