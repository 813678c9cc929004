"""Before others on a busy computer, where the system allows it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

STREAMS, BEHIND = 2, 1
"""Who commands and listens goes before who writes it down, and both before ordinary programs."""
NICE = -10
"""Gets nine tenths of a core that an ordinary program wants too."""


@contextmanager
def real_time(level: int = STREAMS) -> Iterator[str]:
    """This thread, and those it starts in the block, run before all ordinary ones, if allowed.

    A stream of 500 readings and 200 commands a second needs little time, but needs it at once: a
    manifold vents after 0.1 s without a command. On Linux the right comes with the `rtprio` limit
    of /etc/security/limits.conf. `level` is `STREAMS` or `BEHIND`. Yields what it got.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield "ordinary"
        return
    with _under(os.SCHED_RR, level) as allowed:
        yield "real time" if allowed else "ordinary"


def others_too() -> None:
    """Within `real_time`, the same for threads that were there before, such as a library's own."""
    if not os.path.isdir("/proc/self/task"):
        return
    policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
    for thread in os.listdir("/proc/self/task"):
        with suppress(OSError):
            os.sched_setscheduler(int(thread), policy, param)


def prefer() -> None:
    """This program's threads, and those that they start, get more of a busy computer, if allowed.

    For what computes much. Run before all others, that has kept the system's own threads waiting,
    which are ordinary ones and carry a port's bytes: readings stopped. On Linux the right comes
    with the `nice` limit of /etc/security/limits.conf.
    """
    if not hasattr(os, "setpriority"):
        return
    for thread in os.listdir("/proc/self/task") if os.path.isdir("/proc/self/task") else ("0",):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, int(thread), NICE)


@contextmanager
def ordinary() -> Iterator[bool]:
    """What is started in the block does not inherit `real_time`; yields whether this thread has it.

    A program that starts computes for some tenths of a second, and of those that run before all
    others each may keep the rest waiting for 0.1 s.
    """
    if not hasattr(os, "sched_setscheduler") or os.sched_getscheduler(0) == os.SCHED_OTHER:
        yield False
        return
    with _under(os.SCHED_OTHER, 0):
        yield True


@contextmanager
def _under(policy: int, level: int) -> Iterator[bool]:
    """This thread in the block; yields whether that is allowed."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, policy, os.sched_param(level))
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, *before)
