"""Finds swapped columns of pressures from the phases and the amplitudes of the chambers.

A swap is visible in the phases and amplitudes of the pressures relative to each other, because the
trial declares both for each chamber. The distance of two orders of the columns is the largest
change, over all pairs of chambers, of the difference between the two chambers of the pair.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np

from calibration.audit.drive_response import (
    DriveResponses,
    Tones,
    chamber_tones,
    driven_chambers,
    driven_in,
    trial_finding,
    wrapped,
)
from calibration.audit.lag_response import DeclaredDrive
from calibration.measurements.records import Finding, Record

APART = 0.1
"""Two orders are not discriminated if their distance is smaller than this value [periods], or this
difference of ln(amplitude)."""
CLEAR = 0.25
"""An order is certain if its distance from the readings is below this fraction of the distance of
each other order from the readings."""
MOST_CHAMBERS = 6
"""With more chambers, only exchanges of two columns are examined, not all orders."""

Size = Callable[[np.ndarray], np.ndarray]
"""Returns the sizes of differences between two chambers."""


def check_chamber_order(
    records: Sequence[Record], responses: DriveResponses
) -> tuple[list[Record], list[Finding]]:
    """Returns the records with each pressure in its own column, and findings.

    An order that the phases of a trial do not determine follows from the amplitudes. The declared
    amplitudes are then corrected by the gains of the chambers in the trials with a known order.
    Chambers whose set pressure does not change keep their columns.
    """
    drives = driven_chambers(records)
    orders = [_orders_of(d) for d in drives]
    tones = [chamber_tones(r) for r in records]
    found = [
        None if x is None else order_by_phase(x, d, o)
        for x, d, o in zip(tones, drives, orders, strict=True)
    ]
    gains = [
        _log_gain(x.size[o[k]], d)
        for x, d, o, k in zip(tones, drives, orders, found, strict=True)
        if x is not None and k is not None
    ]
    kept, findings = [], []
    for r, x, d, o, k in zip(records, tones, drives, orders, found, strict=True):
        if k is None and x is not None:
            k = order_by_size(x, d, o, gains)
        if not k:
            kept.append(r)
            continue
        moved = [r.channels.pressures[c] for c, at in enumerate(o[k]) if c != at]
        columns = " and ".join(r.channels[n].column for n in moved)
        other = "the other" if len(o[k]) == 2 else "another"
        detail = f"{columns} are swapped: each fits {other} chamber's drive"
        findings.append(trial_finding(r, "swapped_columns", ", ".join(moved), detail, "mended"))
        values, rows = r.values.copy(), r.channels.rows(r.channels.pressures)
        values[rows] = r.pressures[o[k]]
        kept.append(replace(r, values=values))
    return kept, findings


def chamber_orders(chambers: int) -> np.ndarray:
    """Returns orders (k, chambers) of the columns: the column of each chamber.

    The first order is the order of the file.
    """
    own = list(range(chambers))
    if chambers <= MOST_CHAMBERS:
        return np.array(list(permutations(own)))
    found = [own]
    for a, b in combinations(own, 2):
        found.append([{a: b, b: a}.get(i, i) for i in own])
    return np.array(found)


def _orders_of(drives: Sequence[DeclaredDrive]) -> np.ndarray:
    """Returns orders (k, chambers) of the columns, in which only the driven chambers move."""
    own = np.array(driven_in(drives))
    inner = chamber_orders(len(own))
    orders = np.tile(np.arange(len(drives)), (len(inner), 1))
    orders[:, own] = own[inner]
    return orders


class Comparison(NamedTuple):
    """The order that fits the readings best, and distances."""

    best: int
    """Index of the order."""
    off: np.ndarray
    """Distance (k,) of the readings from each order."""
    apart: np.ndarray
    """Distance (k,) of the best order from each order."""

    def only(self, others: np.ndarray) -> int | None:
        """Returns the best order if no order but the `others` (k,) is like it, or else None.

        If the order of the file is like the best order, it is the result.
        """
        if not others[0]:
            return 0
        return self.best if others.sum() == len(others) - 1 else None


def _compared(
    found: np.ndarray, expected: np.ndarray, orders: np.ndarray, size: Size = np.abs
) -> Comparison:
    """Compares the values `found` of the columns with the values `expected` of the chambers."""

    def distance(difference: np.ndarray) -> np.ndarray:
        pairs = difference[..., :, None] - difference[..., None, :]
        return np.nanmax(size(pairs), axis=(-2, -1))

    off = distance(found[orders] - expected)
    best = int(np.argmin(off))
    in_columns = expected[np.argsort(orders, axis=1)]
    return Comparison(best, off, distance(in_columns - in_columns[best]))


def order_by_phase(found: Tones, drives: Sequence[DeclaredDrive], orders: np.ndarray) -> int | None:
    """Returns the index of the order that the phases show; None if they are inconclusive."""
    declared = np.array([x.lag if x.driven else np.nan for x in drives])
    x = _compared(found.lag, declared, orders, lambda lag: np.abs(wrapped(lag)))
    others = x.apart >= APART
    if not others.any() or not (x.off[x.best] < CLEAR * x.off[others]).all():
        return None
    return x.only(others)


def order_by_size(
    found: Tones, drives: Sequence[DeclaredDrive], orders: np.ndarray, gains: Sequence[np.ndarray]
) -> int | None:
    """Returns the index of the order that the amplitudes show; None if they are inconclusive.

    `gains` are ln(measured/declared amplitude) (chambers,) of the trials with a known order.
    """
    own = driven_in(drives)
    known = np.array([x[own] - x[own[0]] for x in gains if np.isfinite(x[own]).all()])
    if len(known) < 2:
        return None
    usual = np.full(len(drives), np.nan)
    usual[own] = np.median(known, axis=0)
    spread = float(np.median(np.abs(known - usual[own]), axis=0).max())
    x = _compared(found.size, usual + _log_amplitudes(drives), orders)
    others = x.apart > max(APART, 8.0 * spread)
    if not others.any() or not (x.off[x.best] < CLEAR * x.apart[others]).all():
        return None
    return x.only(others)


def _log_amplitudes(drives: Sequence[DeclaredDrive]) -> np.ndarray:
    return np.log([abs(x.amplitude) if x.driven else np.nan for x in drives])


def _log_gain(size: np.ndarray, drives: Sequence[DeclaredDrive]) -> np.ndarray:
    return size - _log_amplitudes(drives)
