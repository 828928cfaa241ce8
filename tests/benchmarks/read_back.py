"""How long a session of minutes takes to be read: its joint states, servos and corners, whole, torn and after repair.

Makes a session through the writer, at 30 fps with 10 markers and images of 62 kB, 6 joints and servos at 50 Hz, with a
flush every half second of the session, as in real time. Each reading is a program of its own; its time is that of
`Recording.load` alone, wall clock and processor, and its memory the most that the whole program had.

Run: python -m tests.benchmarks.read_back [--seconds S] [--sizes]
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from argparse import ArgumentParser
from pathlib import Path

import numpy as np

from drivers.safety import ServoState
from station.perception.observations import FrameMarkers
from station.recording import RecordingWriter
from tests.made_sessions import MARKERS, describe

LOAD = """
import json, resource, sys, time
from pathlib import Path
from station.recording import Recording
wall, cpu = time.perf_counter(), time.process_time()
recording = Recording.load(Path(sys.argv[1]))
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
rows = [recording.frames, len(recording.observations), len(recording.measured.t_s)]
print(json.dumps([wall, cpu, memory, *rows, *recording.notices]))
"""


def make(folder: Path, seconds: float, markers: int = 10, joints: int = 6, servos: int = 6, fps: int = 30) -> float:
    """Make the session; returns by how many bytes a second it grew."""
    rng = np.random.default_rng(0)
    table = MARKERS.split("\n[[marker]]")[0] + "".join(
        f'\n[[marker]]\nid = {n}\npart = "p{n}"\nsize_mm = 50.8\n' for n in range(max(1, markers))
    )
    names = tuple(f"j{n}" for n in range(joints))
    about = describe(markers=table, joints=names, units=("rad",) * joints)
    images = [rng.bytes(62_000) for _ in range(20)]
    path = folder / "recording.rrd"
    with RecordingWriter(folder, about, start_ns=0) as writer:
        empty = path.stat().st_size
        for step in range(round(seconds * 150)):
            t_ns = round(step * 1e9 / 150)
            if step % 3 == 0 and joints:
                writer.log_command(t_ns, rng.normal(size=joints))
                writer.log_reading(t_ns, t_ns + 10**6, rng.normal(size=joints), t_ns + np.arange(joints))
                if servos:
                    writer.log_servos(t_ns, {n: ServoState(0, *rng.normal(size=4)) for n in range(servos)})
            if fps and step % (150 // fps) == 0:
                shapes = {"corners_px": (4, 2), "corner_covariance_px2": (4, 2, 2), "T_cam_marker": (2, 4, 4)}
                columns = {name: rng.normal(size=(markers, *shape)) for name, shape in shapes.items()}
                seen = FrameMarkers(np.arange(markers), rms_px=rng.random((markers, 2)), **columns)
                writer.log_frame(step, t_ns, images[step % 20], seen)
            if step % 75 == 74:
                writer.flush()
        writer.close("complete")
    return (path.stat().st_size - empty) / seconds


def tell(what: str, folder: Path) -> None:
    """Read the session in a program of its own and print a row."""
    done = subprocess.run(
        [sys.executable, "-c", LOAD, str(folder)], capture_output=True, text=True, check=True, env={**os.environ}
    )
    wall, cpu, memory, frames, rows, readings, *notices = json.loads(done.stdout)
    print(f"{what:24}{wall:8.2f}{cpu:9.2f}{memory:9.0f}{frames:8}{rows:8}{readings:9}  {'; '.join(notices)}")


def main() -> None:
    """Print the table."""
    options = ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    options.add_argument("--seconds", type=float, default=300.0)
    options.add_argument("--sizes", action="store_true", help="print what station/recording/sizes.py was made from")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as name:
        if given.sizes:
            for k, what in enumerate(((0, 0, 0, 30), (10, 0, 0, 30), (0, 2, 0, 0), (0, 8, 0, 0), (0, 8, 8, 0))):
                print(*what, f"{make(Path(name) / str(k), 20.0, *what):.0f} B/s")
            return
        folder = Path(name) / "session"
        begun_s = time.monotonic()
        rate = make(folder, given.seconds)
        print(f"made in {time.monotonic() - begun_s:.0f} s, {rate * given.seconds / 1e6:.0f} MB")
        print(f"{'':24}{'wall s':>8}{'cpu s':>9}{'MB':>9}{'frames':>8}{'corners':>8}{'readings':>9}")
        tell("complete", folder)
        tell("complete, once more", folder)
        recording = folder / "recording.rrd"
        os.truncate(recording, round(recording.stat().st_size * 0.98))
        tell("torn, with its repair", folder)
        tell("repaired", folder)


if __name__ == "__main__":
    main()
