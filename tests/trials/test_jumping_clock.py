"""The wall clock is set back and forth by hours while a capture runs: nothing but its dates depends on it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from station.commands import fitting
from station.recording import Recording
from station.session import read_status
from tests.trials.programs import capture_arguments, program

SOURCE = Path(__file__).with_name("jumping_clock.c")
HOURS_S = 7 * 3600


@pytest.fixture(scope="module")
def jumping(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The library that makes the clock of a program jump; skips without a C compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler here")
    library = tmp_path_factory.mktemp("clock") / "jumping_clock.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(SOURCE), "-ldl"], check=True)
    return str(library)


def clock(jumping: str, jump_s: int) -> dict[str, str]:
    return {"LD_PRELOAD": jumping, "JUMP": str(jump_s), "AFTER": "1"}


def test_the_clock_of_a_program_jumps_and_its_monotonic_one_does_not(jumping: str) -> None:
    code = (
        "import time\nwall, steady = [], []\nfor _ in range(25):\n    wall.append(time.time())\n"
        "    steady.append(time.monotonic())\n    time.sleep(0.1)\n"
        "steps = [b - a for a, b in zip(wall, wall[1:])]\nprint(max(steps), min(steps), steady[-1] - steady[0])"
    )
    told = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **clock(jumping, HOURS_S)},
        capture_output=True,
        text=True,
        check=True,
    )
    most, least, steady_s = map(float, told.stdout.split())
    assert most == pytest.approx(HOURS_S, abs=60) and least == pytest.approx(-HOURS_S, abs=60)
    assert steady_s < 60


@pytest.mark.parametrize("jump_s", [-HOURS_S, HOURS_S], ids=["back", "forth"])
def test_a_clock_that_jumps_does_no_harm(tmp_path: Path, jumping: str, jump_s: int) -> None:
    with program(tmp_path, *capture_arguments(tmp_path), variables=clock(jumping, jump_s)) as running:
        code, said = running.end()
    assert code == 0, said
    recording = Recording.load(running.session)
    assert read_status(running.session).state == "complete" and recording.notices == ()
    told = {line.stamp_ns for line in running.lines() if line.word == "frame"}
    assert set(recording.frame_ns.tolist()) == told
    steps_s = np.diff(recording.frame_ns) * 1e-9
    assert steps_s.min() > 0 and steps_s.max() < 5
    assert {joint.name for joint in fitting.fit(running.session).fit.tree.joints} >= {"base_pan", "shoulder"}
