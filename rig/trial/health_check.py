"""Checks a rig before a trial: readings, answer times, noise, each chamber, and forces."""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rig.errors import RigError
from rig.force.sensor import ForceSource, SensorMounting
from rig.manifold.driver import Manifold
from rig.protocol.messages import Reading

ANSWER_TIMEOUT = 0.02
"""Longest wait for the reading that answers a command [s]. With this short wait, the watchdog does
not vent if several consecutive readings are lost."""
HOLD_TIME = 1.5
"""Duration of the test of one chamber [s]."""
TIMED_COMMANDS = 50
"""Number of commands whose answers are timed."""
LEAST_HELD = 0.95
"""Lowest pressure of a chamber without a leak, as a fraction of the set pressure."""
LEAST_RECEIVED = 0.9
"""Lowest rate of received readings or force records, as a fraction of the nominal rate."""
FORCE_RATE = 1000.0
"""Nominal rate of a force sensor, in records per second."""


class ChamberCheck(NamedTuple):
    """Result of the test of one chamber at a set pressure."""

    name: str
    asked: float
    """Set pressure [Pa]."""
    reached: float
    """Mean pressure in the last fifth of the test [Pa]."""
    rise: float
    """Time until the pressure is 63 % of `reached` [s]."""
    others: float
    """Highest pressure of another chamber in the last fifth of the test [Pa]; 0 without one."""


class ManifoldCheck(NamedTuple):
    """Result of a manifold's check."""

    rate: float
    """Received readings per second."""
    lost: int
    """Number of lost readings."""
    damaged: int
    """Number of damaged frames."""
    round_trip: np.ndarray
    """(n,) time from a command to the first reading with the command's number [s]."""
    noise: np.ndarray
    """(channels,) standard deviations of the channels at rest, in the units of `channel_names`."""
    offset: np.ndarray
    """(channels,) means of the channels at rest, in the units of `channel_names`."""
    held: list[ChamberCheck]
    findings: list[str]


class ForceCheck(NamedTuple):
    """Result of a force sensor's check at rest."""

    rate: float
    """Received records per second."""
    lost: int
    """Number of lost records."""
    offset: np.ndarray
    """(2,) means of thrust and recoil [N]."""
    noise: np.ndarray
    """(2,) standard deviations of thrust and recoil [N]."""
    findings: list[str]


class ReadingCollector:
    """Collects readings and their arrival times [ns]. `Manifold` calls it in another thread."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, Reading]] = []

    def __call__(self, host_ns: int, reading: Reading) -> None:
        self.rows.append((host_ns, reading))

    def take(self) -> list[tuple[int, Reading]]:
        """Returns the readings since the last call, and removes them from `rows`."""
        rows = self.rows[: len(self.rows)]
        del self.rows[: len(rows)]
        return rows


def check_manifold(
    manifold: Manifold,
    collector: ReadingCollector,
    pressure: float,
    progress: Callable[[str], None] = lambda text: None,
) -> ManifoldCheck:
    """Checks a configured manifold. Each chamber in turn is set to `pressure` [Pa].

    `collector` must be the `on_reading` function of the manifold. Raises `RigError`.
    """
    assert manifold.ident is not None
    progress("at rest")
    collector.take()
    begun = time.monotonic()
    _hold(manifold, 2.0, lambda: None)
    seconds, quiet = time.monotonic() - begun, collector.take()
    if len(quiet) < 2:
        raise RigError("no readings arrive; check the cable from the manifold to the computer")
    channels = np.array([r.channels for _, r in quiet], float)
    rate = len(quiet) / seconds
    manifold.arm()
    progress("answer times")
    trips = _round_trips(manifold, collector)
    held = []
    for chamber, name in enumerate(manifold.limits.chambers):
        progress(f"{name} at {1e-3 * pressure:g} kPa")
        held.append(_check_chamber(manifold, collector, chamber, pressure))
    manifold.stop()
    findings = [
        f"{x.name} reached {1e-3 * x.reached:.1f} kPa instead of {1e-3 * x.asked:.1f}: possibly a "
        "leak, a blocked valve, or a low supply pressure"
        for x in held
        if x.reached < LEAST_HELD * x.asked
    ] + [
        f"while only {x.name} was pressurised, another chamber read {1e-3 * x.others:.1f} kPa: "
        "possibly swapped tubes, or a vent that does not open"
        for x in held
        if x.others > 0.2 * x.asked
    ]
    if rate < LEAST_RECEIVED * manifold.ident.rate:
        findings.append(f"{rate:.0f} readings a second arrive, {manifold.ident.rate} are expected")
    if len(trips) < TIMED_COMMANDS:
        findings.append(
            f"{TIMED_COMMANDS - len(trips)} of {TIMED_COMMANDS} commands were not answered within "
            f"{1e3 * ANSWER_TIMEOUT:g} ms: the line lost them, or the computer is too busy"
        )
    if manifold.lost or manifold.damaged:
        findings.append(f"{manifold.lost} readings lost, {manifold.damaged} frames damaged")
    noise, offset = channels.std(axis=0), channels.mean(axis=0)
    return ManifoldCheck(
        rate, manifold.lost, manifold.damaged, trips, noise, offset, held, findings
    )


def check_force(source: ForceSource, mounting: SensorMounting, seconds: float = 1.0) -> ForceCheck:
    """Checks a force sensor at rest for `seconds` [s]. Raises `RigError`."""
    received: list[tuple[int, bytes]] = []
    source.start(lambda host_ns, piece: received.append((host_ns, piece)))
    try:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            time.sleep(0.05)
            source.check()
        lost = source.health().missing
    finally:
        source.stop()
    forces = source.calibration.forces([t for t, _ in received], [piece for _, piece in received])
    arrived = np.isfinite(forces.wrench).all(axis=1)  # lost records are NaN
    valid = forces.wrench[arrived & ~forces.doubtful]
    if len(valid) < 2:
        raise RigError("the force sensor sends no valid record; check its cable and its load")
    span = 1e-9 * float(forces.t_ns[-1] - forces.t_ns[0])
    rate = (int(arrived.sum()) - 1) / max(span, 1e-9)
    findings = list(forces.findings)
    if rate < LEAST_RECEIVED * FORCE_RATE:
        findings.append(
            f"{rate:.0f} force records a second arrive; set the sensor's RDT rate to {FORCE_RATE:g}"
        )
    values = np.stack(mounting.thrust_and_recoil(valid))
    return ForceCheck(rate, lost, values.mean(axis=1), values.std(axis=1), findings)


def _hold(manifold: Manifold, seconds: float, command: Callable[[], object]) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        command()
        manifold.check()
        time.sleep(0.01)


def _round_trips(manifold: Manifold, collector: ReadingCollector) -> np.ndarray:
    trips, zero = [], (0.0,) * len(manifold.limits.chambers)
    for _ in range(TIMED_COMMANDS):
        collector.take()
        begun, seq = time.monotonic_ns(), manifold.set(zero)
        end = time.monotonic() + ANSWER_TIMEOUT
        while time.monotonic() < end:
            arrival = next((t for t, r in list(collector.rows) if r.command == seq), None)
            if arrival is not None:
                trips.append(1e-9 * (arrival - begun))
                break
            time.sleep(0.0005)
        manifold.check()
    return np.array(trips)


def _check_chamber(
    manifold: Manifold, collector: ReadingCollector, chamber: int, pressure: float
) -> ChamberCheck:
    names = manifold.limits.chambers
    pressures = [pressure if i == chamber else 0.0 for i in range(len(names))]
    collector.take()
    begun = time.monotonic_ns()
    _hold(manifold, HOLD_TIME, lambda: manifold.set(pressures))
    rows = collector.take()
    t = np.array([1e-9 * (host_ns - begun) for host_ns, _ in rows])
    p = np.array([r.pressures for _, r in rows], float)
    if not (t > 0.8 * HOLD_TIME).any():
        raise RigError(f"no readings arrived during the test of {names[chamber]}; check the cable")
    reached = float(p[t > 0.8 * HOLD_TIME, chamber].mean())
    above = np.flatnonzero(p[:, chamber] >= 0.632 * reached)
    rise = float(t[above[0]]) if len(above) else float("nan")
    others = np.delete(p, chamber, axis=1)[t > 0.8 * HOLD_TIME]
    highest = float(others.max()) if others.size else 0.0
    _hold(manifold, 0.5, lambda: manifold.set([0.0] * len(names)))
    return ChamberCheck(names[chamber], pressure, reached, rise, highest)
