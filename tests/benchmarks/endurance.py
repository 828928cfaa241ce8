"""Five minutes of a capture in real time: frames lost and why, jitter of stamps, processor and memory by the minute.

`station capture` runs as a program of its own on the packaged demo rig, which draws its pictures (30 a second) and
emulates its six servos (50 readings a second) within the same program. `--apart` keeps the arm and a network camera
outside of it, as real ones are. Meanwhile the kernel's counts of the program and of the machine are read four times a
second.

A frame counts as one that the machine had time for if it was lost while more than a tenth of all cores was idle: from
half a second before the gap in the recorded frames' numbers to the gap's end.

Run: python -m tests.benchmarks.endurance [--minutes N] [--apart] [--keep DIR]
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from station.recording import Recording
from station.session import read_status
from tests.benchmarks.two_hours import CYCLE_S, motion_text
from tests.trials.bench import bench
from tests.trials.load import LoadSampler
from tests.trials.programs import Program, capture_arguments, program

FPS, SERVO_HZ = 30.0, 50.0
IDLE_SHARE = 0.1
BEFORE_S = 0.5
LEAK_MB = 10.0
PERCENTILES = (1, 50, 99, 99.9, 100)


@contextmanager
def capturing(folder: Path, minutes: float, *, apart: bool) -> Iterator[Program]:
    """A capture of so many minutes that has just begun."""
    motion = motion_text(max(1, round(60 * minutes / CYCLE_S)))
    if not apart:
        with program(folder, *capture_arguments(folder, motion=motion)) as running:
            yield running
        return
    with bench(folder, "demo") as lab:
        arguments = capture_arguments(folder, rig=str(lab.rig), motion=motion)
        with program(folder, *arguments) as running:
            yield running


def show_minutes(load: LoadSampler, recording: Recording) -> None:
    """Print what was taken and lost in each minute of the motion, and what that took."""
    rows = load.rows
    start_s = recording.frame_ns[0] * 1e-9
    cores = len(os.sched_getaffinity(0))
    print("minute  frames   lost  own cpu [%]  idle [%]  memory [MB]  most [MB]  threads  files")
    frame_s = recording.frame_ns * 1e-9 - start_s
    for minute in range(int(np.ceil(frame_s[-1] / 60))):
        at = rows[(rows[:, 0] >= start_s + 60 * minute) & (rows[:, 0] < start_s + 60 * (minute + 1))]
        there = (frame_s >= 60 * minute) & (frame_s < 60 * (minute + 1))
        if len(at) < 2 or not there.any():
            continue
        span_s = at[-1, 0] - at[0, 0]
        lost = np.diff(recording.frame_index[there]).sum() - there.sum() + 1
        own, idle = (at[-1, 2] - at[0, 2]) / span_s, (at[-1, 1] - at[0, 1]) / span_s / cores
        print(
            f"{minute + 1:6} {there.sum():7} {lost:6} {100 * own:12.0f} {100 * idle:9.0f} {at[:, 3].mean():12.1f} "
            f"{at[:, 3].max():10.1f} {at[:, 4].max():8.0f} {at[:, 5].max():6.0f}"
        )


def show_leak(load: LoadSampler, recording: Recording) -> None:
    """Print how memory went from the end of the first minute on."""
    rows, first_s = load.rows, recording.frame_ns[0] * 1e-9
    last_s = recording.frame_ns[-1] * 1e-9
    begin_s = first_s + min(60.0, (last_s - first_s) / 3)
    at = rows[(rows[:, 0] >= begin_s) & (rows[:, 0] <= last_s)]
    slope = float(np.polyfit(at[:, 0], at[:, 3], 1)[0])
    grown = slope * (at[-1, 0] - at[0, 0])
    verdict = "flat" if grown < LEAK_MB else f"LEAKS, wanted less than {LEAK_MB:g} MB"
    print(
        f"memory over {at[-1, 0] - at[0, 0]:.0f} s: {at[0, 3]:.1f} to {at[-1, 3]:.1f} MB, "
        f"line through it {grown:+.1f} MB: {verdict}"
    )


def show_losses(load: LoadSampler, recording: Recording, counts: dict[str, int]) -> None:
    """Print what was lost by reason, and how much of it while the machine had time."""
    stamps_s, index = recording.frame_ns * 1e-9, recording.frame_index
    gaps = np.flatnonzero(np.diff(index) > 1)
    with_time = without = 0
    for k in gaps.tolist():
        lost = int(index[k + 1] - index[k] - 1)
        if load.idle_share(float(stamps_s[k]) - BEFORE_S, float(stamps_s[k + 1])) > IDLE_SHARE:
            with_time += lost
        else:
            without += lost
    taken = int(index[-1] - index[0] + 1)
    print(f"frames: {taken} in the camera's numbers, {len(index)} recorded")
    print(f"lost: {with_time} while the machine had time, {without} while it was busy (in {len(gaps)} gaps)")
    print(f"session.json: {', '.join(f'{name} {number}' for name, number in counts.items())}")


def show_jitter(recording: Recording, fps: float) -> None:
    """Print how even the stamps are."""
    steps = np.diff(recording.frame_index)
    frame_ms = (np.diff(recording.frame_ns) - steps / fps * 1e9) * 1e-6
    request, reply = recording.stamps_ns.T
    rows = {
        "frame to frame, less its period": frame_ms,
        "reading to reading, less 20 ms": np.diff(request) * 1e-6 - 1e3 / SERVO_HZ,
        "request to reply": (reply - request) * 1e-6,
    }
    print(f"{'stamps [ms]':34}" + "".join(f"{f'p{p:g}':>9}" for p in PERCENTILES))
    for name, values in rows.items():
        print(f"{name:34}" + "".join(f"{value:9.2f}" for value in np.percentile(values, PERCENTILES)))
    print(f"readings a second: {len(request) / ((request[-1] - request[0]) * 1e-9):.2f}, wanted {SERVO_HZ:g}")


def main() -> None:
    """Print the tables."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--minutes", type=float, default=5.0)
    options.add_argument("--apart", action="store_true", help="arm and camera are outside of the program")
    options.add_argument("--keep", type=Path, help="folder to work in, kept; a temporary one if left out")
    chosen = options.parse_args()
    print(f"load of the machine before: {os.getloadavg()[0]:.2f} on {len(os.sched_getaffinity(0))} cores")
    with tempfile.TemporaryDirectory() as name:
        folder = chosen.keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        with capturing(folder, chosen.minutes, apart=chosen.apart) as running, LoadSampler(running.process.pid) as load:
            code, said = running.end(patience_s=60 * chosen.minutes + 120)
        print(f"exit code {code}{'' if code == 0 else said}")
        recording = Recording.load(running.session)
        show_minutes(load, recording)
        show_leak(load, recording)
        show_losses(load, recording, dict(read_status(running.session).counts))
        show_jitter(recording, FPS)


if __name__ == "__main__":
    main()
