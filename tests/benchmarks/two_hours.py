"""Two hours of a capture on the virtual clock: memory, the recording's size, and the memory of its fit.

The packaged demo rig goes through a cycle of four steps, 6 s long, again and again; servos at 50 Hz, all through the
emulated bus and the recording that a real session has. What is simulated more cheaply than in a session: a picture
that was drawn for the same joint states, to within 0.1 deg, is shown again with its noise, and what the detector found
in it is found again (`--detect` runs it on every frame). Poses, JPEGs and recording are made anew for every frame.

Memory is read at every minute of the session's time, and must not grow in the second half: before that, allocators
still settle. The fit runs as a program of its own, whose peak the kernel tells.

Run: python -m tests.benchmarks.two_hours [--hours H] [--fps N] [--quick] [--detect] [--keep DIR]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from station.commands import capturing
from station.commands.fitting import MOST_MARKERS
from station.perception.jpeg import encode_jpeg
from station.perception.marker_tracker import MarkerTracker
from station.recording.sizes import expected_rates
from station.rig import load_rig
from station.stage import Stage
from tests.trials.memory import resident_mb, run_measured

CYCLE_S = 6.0
POSES = ((20, 15, -30, 20), (-20, 15, -10, 20), (-20, -15, -10, -20), (20, -15, -30, -20))
JOINTS = ("base_pan", "shoulder", "elbow", "wrist")
SAME_DEG = 0.1
FLAT_MB = 10.0
# What a fit is said to take at most (docs/python.md), MB.
FIT_MB = 4500.0
STATION = (sys.executable, "-c", "from station.cli import main; main()")


def motion_text(cycles: int) -> str:
    """A motion.toml that goes through the poses so many times."""
    lines = ['schema = "motion/1"', 'name = "cycles"']
    for _ in range(cycles):
        for pose in POSES:
            move = ", ".join(f"{joint} = {deg}" for joint, deg in zip(JOINTS, pose, strict=True))
            lines += ["[[step]]", f"move = {{ {move} }}", "speed_deg_s = 40", "hold_s = 0.5"]
    return "\n".join(lines) + "\n"


class Pictures:
    """Pictures by the joint states that they show; a picture is drawn where there is none of nearly the same states."""

    def __init__(self) -> None:
        self._draw, self._states, self._known = Stage.render, [], []
        self.asked = 0

    def __call__(self, stage: Stage, q: np.ndarray, index: int) -> np.ndarray:
        self.asked += 1
        if self._states:
            apart = np.abs(np.array(self._states) - q.ravel()).max(axis=1)
            if apart.min() <= np.radians(SAME_DEG):
                return self._known[int(apart.argmin())]
        self._states.append(q.ravel())
        self._known.append(self._draw(stage, q, index))
        return self._known[-1]

    @property
    def first(self) -> np.ndarray:
        """The first picture that was drawn."""
        return self._known[0]

    @property
    def made(self) -> int:
        return len(self._known)

    @property
    def mb(self) -> float:
        """Memory of the pictures that are kept: what the benchmark itself takes, MB."""
        return sum(picture.nbytes for picture in self._known) / 1e6


class Detected:
    """What a tracker found in each picture, at its first look at it."""

    def __init__(self) -> None:
        self._detect, self._found = MarkerTracker.detect, {}

    def __call__(self, tracker: MarkerTracker, image: np.ndarray) -> Any:
        if id(image) not in self._found:  # the pictures are kept: their ids stay theirs
            self._found[id(image)] = self._detect(tracker, image)
        return self._found[id(image)]


def remembering(*, detect: bool) -> Pictures:
    """Have all stages draw each picture once, and all trackers look at each once unless `detect`."""
    pictures, detected = Pictures(), Detected()
    Stage.render = lambda self, q, index: pictures(self, q, index)
    if not detect:
        MarkerTracker.detect = lambda self, image: detected(self, image)
    return pictures


def run(folder: Path, hours: float, fps: float, pictures: Pictures) -> tuple[Path, np.ndarray]:
    """Capture, and return the session with (minutes, MB in memory, MB of the recording, s taken) for each minute.

    Memory is without that of the pictures that the benchmark keeps.
    """
    text = load_rig("demo").text.replace("fps = 30", f"fps = {fps:g}")
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    (folder / "motion.toml").write_text(motion_text(round(hours * 3600 / CYCLE_S)), encoding="utf-8")
    session, rows, begun_s = folder / "session", [], time.monotonic()

    def look(done_s: float, total_s: float) -> None:
        if done_s >= 60 * (len(rows) + 1) or done_s >= total_s:
            size_mb = sum(path.stat().st_size for path in session.glob("*.rrd")) / 1e6
            rows.append((done_s / 60, resident_mb() - pictures.mb, size_mb, time.monotonic() - begun_s))
            if len(rows) % 10 == 0 or done_s >= total_s:
                print(
                    "{:8.1f} min {:8.1f} MB in memory {:9.1f} MB on disk {:8.0f} s taken".format(*rows[-1]), flush=True
                )

    counts = capturing.capture(str(folder / "rig.toml"), str(folder / "motion.toml"), session, seed=0, progress=look)
    print(", ".join(f"{name} {number}" for name, number in counts.as_dict().items()))
    return session, np.array(rows)


def show_memory(rows: np.ndarray) -> None:
    """Print how memory went after the first tenth, and whether it stayed flat in the second half."""
    later = rows[max(1, len(rows) // 10) :]
    second = rows[len(rows) // 2 :]
    verdict = "flat" if _grown_mb(second) < FLAT_MB else f"NOT flat, wanted less than {FLAT_MB:g} MB"
    least, most = later[:, 1].min(), later[:, 1].max()
    print(
        f"memory from minute {later[0, 0]:.0f} to {later[-1, 0]:.0f}: {least:.1f} to {most:.1f} MB, line through them "
        f"{_grown_mb(later):+.1f} MB; from minute {second[0, 0]:.0f} on {_grown_mb(second):+.1f} MB: {verdict}"
    )


def _grown_mb(rows: np.ndarray) -> float:
    """How much the line through some minutes' memory rises."""
    slope = float(np.polyfit(rows[:, 0], rows[:, 1], 1)[0]) if len(rows) > 2 else 0.0
    return slope * (rows[-1, 0] - rows[0, 0])


def show_size(folder: Path, session: Path, rows: np.ndarray, first: np.ndarray) -> None:
    """Print the recording's size beside what `station doctor` would have foretold from the first picture."""
    rates = expected_rates(load_rig(str(folder / "rig.toml")).table, frame_bytes=len(encode_jpeg(first)))
    had_mb = sum(path.stat().st_size for path in session.glob("*.rrd")) / 1e6
    foretold_mb = rates.bytes_per_s * 60 * rows[-1, 0] / 1e6
    share = had_mb / foretold_mb
    print(f"recording: {had_mb:.1f} MB, foretold with all markers seen {foretold_mb:.1f} MB, {share:.2f} of that")


def main() -> None:
    """Print the tables."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--hours", type=float, default=2.0)
    options.add_argument("--fps", type=float, default=30.0)
    options.add_argument("--quick", action="store_true", help="four minutes")
    options.add_argument("--detect", action="store_true", help="look for markers in every frame")
    options.add_argument("--keep", type=Path, help="folder to work in, kept; a temporary one if left out")
    chosen = options.parse_args()
    pictures = remembering(detect=chosen.detect)
    with tempfile.TemporaryDirectory() as name:
        folder = chosen.keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        session, rows = run(folder, 4 / 60 if chosen.quick else chosen.hours, chosen.fps, pictures)
        print(
            f"{pictures.made} pictures drawn for {pictures.asked} frames; their {pictures.mb:.0f} MB are left out here"
        )
        show_memory(rows)
        show_size(folder, session, rows, pictures.first)
        code, peak_mb, processor_s = run_measured([*STATION, "fit", str(session)])
        verdict = "within" if peak_mb <= FIT_MB else "NOT within"
        print(
            f"fit: exit code {code}, peak {peak_mb:.0f} MB, {verdict} the {FIT_MB:.0f} MB that are stated "
            f"(at most {MOST_MARKERS} markers), {processor_s:.0f} s of processor time"
        )


if __name__ == "__main__":
    main()
