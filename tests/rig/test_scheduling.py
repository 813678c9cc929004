"""Who goes first on a busy computer, where the system allows it."""

import os
import subprocess
import sys

import pytest

from rig.scheduling import NICE, real_time
from tests.support.data import ROOT

PREFERS = """
import os, threading
from rig.scheduling import prefer
end = threading.Event()
there = threading.Thread(target=end.wait)
there.start()
prefer()
print(*(os.getpriority(os.PRIO_PROCESS, int(x)) for x in os.listdir("/proc/self/task")))
end.set()
"""


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="threads are listed on Linux only")
def test_threads_that_were_there_are_preferred_too():
    """Not allowed, it says nothing and changes nothing."""
    words = [sys.executable, "-c", f"import os; os.nice({NICE})"]
    allowed = subprocess.run(words, stderr=subprocess.DEVNULL).returncode == 0
    said = subprocess.run([sys.executable, "-c", PREFERS], cwd=ROOT, capture_output=True, text=True)
    own = os.getpriority(os.PRIO_PROCESS, 0)
    assert said.stdout.split() == [str(NICE if allowed else own)] * 2, said.stderr


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="no such priorities here")
def test_a_thread_is_before_others_in_the_block_only():
    before = os.sched_getscheduler(0)
    with real_time() as got:
        expected = {"real time": os.SCHED_RR, "ordinary": before}
        assert os.sched_getscheduler(0) == expected[got]
    assert os.sched_getscheduler(0) == before
