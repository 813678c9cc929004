"""Sets thread priorities for a busy computer, if the operating system allows them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

STREAM_PRIORITY, RECORDER_PRIORITY = 2, 1
"""Real-time priorities of stream threads and of the recorder; the larger priority runs first."""
NICE = -10
"""Niceness with which a program gets 90 % of a core that it shares with an ordinary program."""


@contextmanager
def real_time_priority(level: int = STREAM_PRIORITY) -> Iterator[str]:
    """Gives real-time priority to this thread, and to threads that this thread starts in the block.

    A stream of 500 readings and 200 commands per second needs little processor time, but must not
    be delayed: the manifold vents after 0.1 s without a command. On Linux, the `rtprio` limit of
    /etc/security/limits.conf grants the permission. `level` is `STREAM_PRIORITY` or
    `RECORDER_PRIORITY`. Yields "real time", or "ordinary" if the system refuses the priority.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield "ordinary"
        return
    with _scheduled(os.SCHED_RR, level) as allowed:
        yield "real time" if allowed else "ordinary"


def share_priority_with_all_threads() -> None:
    """Gives this thread's priority to all threads of the program, also to a library's threads."""
    if not os.path.isdir("/proc/self/task"):
        return
    policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
    for thread in os.listdir("/proc/self/task"):
        with suppress(OSError):
            os.sched_setscheduler(int(thread), policy, param)


def raise_priority() -> None:
    """Sets the niceness of all threads of this program to `NICE`, if the system allows it.

    Use this function in a program that computes much. With real-time priority, such a program
    delays the system's threads that transfer a port's bytes, and the readings stop. On Linux, the
    `nice` limit of /etc/security/limits.conf grants the permission.
    """
    if not hasattr(os, "setpriority"):
        return
    for thread in os.listdir("/proc/self/task") if os.path.isdir("/proc/self/task") else ("0",):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, int(thread), NICE)


@contextmanager
def ordinary_priority() -> Iterator[bool]:
    """Removes this thread's real-time priority in the block. Yields whether the thread had one.

    Start other programs in this block, so that they have no real-time priority. A program computes
    for some tenths of a second after its start, and could delay all other programs by 0.1 s.
    """
    if not hasattr(os, "sched_setscheduler") or os.sched_getscheduler(0) == os.SCHED_OTHER:
        yield False
        return
    with _scheduled(os.SCHED_OTHER, 0):
        yield True


@contextmanager
def _scheduled(policy: int, level: int) -> Iterator[bool]:
    """Sets this thread's policy and priority in the block. Yields False if the system refuses."""
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
