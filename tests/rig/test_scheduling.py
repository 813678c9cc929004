"""Thread priorities on a busy computer, where the operating system allows them."""

import os
import subprocess
import sys

import pytest

from rig.scheduling import NICE, real_time_priority
from tests.support.data import ROOT

RAISE_PRIORITY = """
import os, threading
from rig.scheduling import raise_priority
end = threading.Event()
existing = threading.Thread(target=end.wait)
existing.start()
raise_priority()
print(*(os.getpriority(os.PRIO_PROCESS, int(x)) for x in os.listdir("/proc/self/task")))
end.set()
"""


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="only Linux lists its threads")
def test_existing_threads_get_the_higher_priority_too():
    """Without the permission, `raise_priority` changes nothing and raises no error."""
    command = [sys.executable, "-c", f"import os; os.nice({NICE})"]
    allowed = subprocess.run(command, stderr=subprocess.DEVNULL).returncode == 0
    command = [sys.executable, "-c", RAISE_PRIORITY]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    own = os.getpriority(os.PRIO_PROCESS, 0)
    assert result.stdout.split() == [str(NICE if allowed else own)] * 2, result.stderr


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="the system has no policies")
def test_real_time_priority_ends_with_its_block():
    before = os.sched_getscheduler(0)
    with real_time_priority() as got:
        expected = {"real time": os.SCHED_RR, "ordinary": before}
        assert os.sched_getscheduler(0) == expected[got]
    assert os.sched_getscheduler(0) == before
