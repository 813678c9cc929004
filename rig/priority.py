"""Before others on a busy computer, where the system allows it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

STREAMS, RECORDER = 2, 1
"""Who commands and listens goes before who writes it down, and both before ordinary programs."""


@contextmanager
def real_time() -> Iterator[str]:
    """This thread, and those it starts in the block, run before all ordinary ones, if allowed.

    A stream of 500 readings and 200 commands a second needs little time, but needs it at once: a
    manifold vents after 0.1 s without a command. On Linux the right comes with the `rtprio` limit
    of /etc/security/limits.conf. Yields what it got.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield "ordinary"
        return
    policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(STREAMS))
    except OSError:
        yield "ordinary"
        return
    try:
        yield "real time"
    finally:
        os.sched_setscheduler(0, policy, param)


def others_too() -> None:
    """Within `real_time`, the same for threads that were there before, such as a library's own."""
    if not os.path.isdir("/proc/self/task"):
        return
    policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
    for thread in os.listdir("/proc/self/task"):
        with suppress(OSError):
            os.sched_setscheduler(int(thread), policy, param)


@contextmanager
def ordinary() -> Iterator[bool]:
    """What is started in the block does not inherit `real_time`; yields whether this thread has it.

    A program that starts computes for some tenths of a second, and of those that run before all
    others each may keep the rest waiting for 0.1 s.
    """
    if not hasattr(os, "sched_setscheduler") or os.sched_getscheduler(0) == os.SCHED_OTHER:
        yield False
        return
    policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield True
    finally:
        os.sched_setscheduler(0, policy, param)


def behind_its_program() -> None:
    """This process, which a program that is `real_time` has started, runs behind that one and
    before all ordinary ones."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(RECORDER))
