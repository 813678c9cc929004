"""Findings of an audit: a fault of the data, and the action taken."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

Action = Literal["masked", "mended", "left out", "used", "refused"]


class Finding(NamedTuple):
    """One fault of one file.

    | action | what was done |
    |---|---|
    | `masked` | the samples are treated as missing |
    | `mended` | corrected, as `detail` says |
    | `left out` | the whole trial is not used |
    | `used` | none; the finding is for information |
    | `refused` | the whole experiment cannot be used |
    """

    trial: str
    """The file."""
    kind: str
    channel: str | None
    from_s: float | None
    to_s: float | None
    detail: str
    """One sentence for the report."""
    action: Action

    def told(self) -> dict[str, Any]:
        """As report.json says it."""
        return self._asdict()

    def __str__(self) -> str:
        return f"{self.trial}: {self.detail} ({self.action})"


def left_out(findings: Sequence[Finding]) -> set[str]:
    """Files of the trials that are left out."""
    return {x.trial for x in findings if x.action == "left out"}


def stretches(bad: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every run of True in `bad` (n,)."""
    edges = np.flatnonzero(np.diff(np.r_[0, bad.astype(int), 0]))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def masked(
    trial: str, kind: str, channel: str, t: np.ndarray, bad: np.ndarray, text: str
) -> Finding:
    """The finding that the samples `bad` (n,) of a channel at `t` (n,) [s] are masked."""
    runs, count = stretches(bad), int(bad.sum())
    where = f"from {t[runs[0][0]]:.4g} to {t[runs[-1][1]]:.4g} s"
    many = f" in {len(runs)} stretches" if len(runs) > 1 else ""
    detail = f"{text}: {count} samples{many} {where} are not used"
    return Finding(
        trial, kind, channel, float(t[runs[0][0]]), float(t[runs[-1][1]]), detail, "masked"
    )
