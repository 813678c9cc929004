"""Thread priorities on a busy computer, where the operating system allows them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

STREAM_PRIORITY, RECORDER_PRIORITY = 2, 1
"""The threads that command and read go before the recorder; both go before ordinary programs."""
NICE = -10
"""With this niceness a program gets nine tenths of a core that an ordinary program also wants."""


@contextmanager
def real_time_priority(level: int = STREAM_PRIORITY) -> Iterator[str]:
    """Runs this thread, and the threads it starts in the block, before all ordinary ones.

    A stream of 500 readings and 200 commands a second needs little processor time, but needs it at
    once: a manifold vents after 0.1 s without a command. On Linux, the `rtprio` limit of
    /etc/security/limits.conf grants the permission. `level` is `STREAM_PRIORITY` or
    `RECORDER_PRIORITY`. Yields "real time", or "ordinary" if the system does not allow it.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield "ordinary"
        return
    with _scheduled(os.SCHED_RR, level) as allowed:
        yield "real time" if allowed else "ordinary"


def share_priority_with_all_threads() -> None:
    """Gives this thread's priority to all existing threads of the program, such as a library's."""
    if not os.path.isdir("/proc/self/task"):
        return
    policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
    for thread in os.listdir("/proc/self/task"):
        with suppress(OSError):
            os.sched_setscheduler(int(thread), policy, param)


def raise_priority() -> None:
    """Lowers the niceness of this program's threads, and of those they start, if allowed.

    This is for programs that compute much. With real-time priority such a program kept the
    system's own threads waiting. Those are ordinary threads that carry a port's bytes, and the
    readings stopped. On Linux, the `nice` limit of /etc/security/limits.conf grants the permission.
    """
    if not hasattr(os, "setpriority"):
        return
    for thread in os.listdir("/proc/self/task") if os.path.isdir("/proc/self/task") else ("0",):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, int(thread), NICE)


@contextmanager
def ordinary_priority() -> Iterator[bool]:
    """Starts programs in the block without `real_time_priority`. Yields whether this thread has it.

    A starting program computes for some tenths of a second. With real-time priority it could keep
    all other programs waiting for 0.1 s.
    """
    if not hasattr(os, "sched_setscheduler") or os.sched_getscheduler(0) == os.SCHED_OTHER:
        yield False
        return
    with _scheduled(os.SCHED_OTHER, 0):
        yield True


@contextmanager
def _scheduled(policy: int, level: int) -> Iterator[bool]:
    """Sets this thread's policy and priority in the block; yields whether the system allows it."""
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
