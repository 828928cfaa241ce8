"""The program that draws a stage's pictures: the same pictures, and it neither outlives the station nor hangs it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import MonotonicClock
from drivers.errors import CameraError
from station.hand_motion import HandMovedObject
from station.rig import load_rig, rendered_camera
from station.stage import Stage
from station.stage_apart import StageApart

# A program that has a stage drawn, tells the drawing program's id, and then waits to be killed.
STATION = """
import time
from tests.test_stage_apart import demo_stage
from station.stage_apart import StageApart
with StageApart(demo_stage()) as apart:
    print(apart.pid, flush=True)
    time.sleep(60)
"""

sees_programs = pytest.mark.skipif(
    not Path("/proc/thread-self/children").exists(), reason="needs /proc to see which programs there are"
)


def demo_stage() -> Stage:
    rig = load_rig("demo")
    assert rig.table.simulation is not None
    return Stage(rig.table, rig.table.simulation, rig.camera_model, seed=3)


def gone(pid: int) -> bool:
    """Whether no program has the id any more, within ten seconds."""
    for _ in range(200):
        if not Path(f"/proc/{pid}").exists() or "Z (zombie)" in Path(f"/proc/{pid}/status").read_text():
            return True
        time.sleep(0.05)
    return False


def test_a_stage_apart_draws_the_same_pictures_to_the_bit():
    stage = demo_stage()
    rng = np.random.default_rng(0)
    states = rng.normal(0, 0.3, (3, 2, 1, 4))
    with StageApart(stage) as apart:
        drawn = [apart.render(q, index) for index, q in enumerate(states)]
    for index, q in enumerate(states):
        np.testing.assert_array_equal(drawn[index], stage.render(q, index))
    assert not np.array_equal(drawn[0], drawn[1])
    assert drawn[0].flags.writeable


def test_a_ctrl_c_that_reaches_the_drawing_program_is_not_its_own():
    with StageApart(demo_stage()) as apart:
        os.kill(apart.pid, signal.SIGINT)
        assert apart.render(np.zeros((1, 1, 4)), 0).shape == (480, 640, 3)


@sees_programs
def test_a_camera_whose_drawing_program_has_ended_says_so():
    rig = load_rig("demo")
    assert rig.table.simulation is not None
    clock = MonotonicClock()
    still = HandMovedObject(4, None, clock.now_ns())
    camera = rendered_camera(rig.table, rig.table.simulation.camera, demo_stage(), still, clock, realtime=True)
    before = children()
    camera.start()
    try:
        assert camera.read(clock.now_ns() + 10**10) is not None
        (drawing,) = children() - before
        os.kill(drawing, signal.SIGKILL)
        with pytest.raises(CameraError, match="program that draws its pictures has ended"):
            while camera.read(clock.now_ns() + 10**10) is not None:
                continue
    finally:
        camera.close()


def test_nothing_is_drawn_before_the_start():
    with pytest.raises(CameraError, match="isn't started"):
        StageApart(demo_stage()).render(np.zeros((1, 1, 4)), 0)


@sees_programs
def test_the_drawing_program_ends_when_the_station_is_killed():
    with subprocess.Popen([sys.executable, "-c", STATION], stdout=subprocess.PIPE, text=True) as station:
        assert station.stdout is not None
        pid = int(station.stdout.readline())
        station.kill()
    assert gone(pid)


def children() -> set[int]:
    """Ids of this program's children."""
    return {int(pid) for pid in Path("/proc/thread-self/children").read_text().split()}
