"""Sharing out the work of a fit."""

import ctypes
import os
import subprocess
import sys
import threading

import pytest

from station.fit import parallel


def test_work_is_shared_out_but_where_fits_run_side_by_side_already(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(parallel, "cores", lambda: 4)
    here, meeting = threading.get_ident(), threading.Barrier(2)

    def who(_: int) -> int:
        meeting.wait(10)  # two threads come here together, or none gets on
        return threading.get_ident()

    assert here not in parallel.each(who, range(2))
    with parallel.in_this_thread():
        assert parallel.each(lambda _: threading.get_ident(), range(2)) == [here, here]
    assert here not in parallel.each(who, range(2))


# Minor page faults while arrays of 4 MB, 1,024 pages of 4 KiB each, are filled one after another.
FAULTS = """
import resource
import numpy as np
from station.fit.parallel import keep_freed_memory
keep_freed_memory()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    np.ones(2**19)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="this C library can't be told what to keep")
def test_freed_memory_is_kept_also_where_the_environment_says_to_give_it_back():
    """As Dask's nanny does, for its workers."""
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    told = subprocess.run([sys.executable, "-c", FAULTS], env=environment, check=True, capture_output=True, text=True)
    assert int(told.stdout) < 5 * 1024
