"""What was foreseen of a motion against what was then detected, marker by marker and frame by frame.

The forecast knows what the rig draws; the session is of an arm that was built by hands (each plate and the camera off
by the rig's placement_mm and placement_deg, drawn by the seed), whose servos gain speed and lag. A marker-frame agrees
if the marker was foreseen seen and detected, or neither. Tilt, size, place and speed are compared where it was both.
Near a change of what is foreseen the two may differ by when it comes: the agreement away from these is told apart.

Run: python -m tests.benchmarks.foresight [--rigs NAME ...] [--seeds N]
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from station.commands import capturing, fitting
from station.commands.planning import planned_motion
from station.drawn_scene import drawn_scene
from station.foresight.forecast import Forecast, foresee
from station.perception.observations import ObservationLog
from station.rig import load_rig
from station.tracking import viewing_angles

RIGS = ("demo", "openmanipulator_x")
# Frames about a change of what is foreseen in which the detection may have changed already, or not yet.
NEAR_FRAMES = 3


@dataclass(frozen=True)
class Score:
    """Of one session."""

    marker_frames: int
    agree: float
    agree_far: float
    tilt_rms_deg: float
    size_rms_px: float
    place_rms_px: float
    speed_rms: float
    differ: Counter[str]


def detected(observations: ObservationLog, forecast: Forecast) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether each marker was detected (F, M), at which tilt [rad], and its corners (F, M, 4, 2)."""
    shape = len(observations.t_s), len(forecast.scene.mounts)
    seen, tilt, corners = np.zeros(shape, bool), np.full(shape, np.nan), np.full((*shape, 4, 2), np.nan)
    for m, mount in enumerate(forecast.scene.mounts):
        rows = np.flatnonzero(observations.marker_id == mount.marker_id)
        frames = observations.frame[rows]
        seen[frames, m] = True
        tilt[frames, m] = viewing_angles(observations)[rows]
        corners[frames, m] = observations.corners_px[rows]
    return seen, tilt, corners


def near_change(seen: np.ndarray) -> np.ndarray:
    """(F, M) whether what is foreseen changes within NEAR_FRAMES."""
    near = np.zeros_like(seen)
    for f, m in zip(*np.nonzero(seen[1:] != seen[:-1]), strict=True):
        near[max(f + 1 - NEAR_FRAMES, 0) : f + 1 + NEAR_FRAMES, m] = True
    return near


def score(forecast: Forecast, observations: ObservationLog) -> Score:
    seen, tilt, corners = detected(observations, forecast)
    same = seen == forecast.seen
    both = seen & forecast.seen
    size = np.linalg.norm(np.roll(corners, -1, axis=-2) - corners, axis=-1).max(axis=-1)
    moved = np.linalg.norm(np.roll(corners, -1, axis=0) - np.roll(corners, 1, axis=0), axis=-1).max(axis=-1)
    period_s = np.roll(forecast.t_s, -1) - np.roll(forecast.t_s, 1)
    speed = (moved / period_s[:, None])[1:-1]
    told = forecast.sight.speed_px_s[1:-1]
    quick = np.isfinite(speed) & (told > 50) & both[1:-1]
    middle = np.nanmean(np.linalg.norm(corners - forecast.sight.corners_px, axis=-1)[both] ** 2) ** 0.5
    differ = Counter(
        f"{forecast.scene.mounts[m].part}: {'not detected' if forecast.seen[f, m] else 'detected, though'} "
        f"{forecast.why(int(f), int(m))}"
        for f, m in zip(*np.nonzero(~same), strict=True)
    )
    return Score(
        marker_frames=same.size,
        agree=float(same.mean()),
        agree_far=float(same[~near_change(forecast.seen)].mean()),
        tilt_rms_deg=float(np.degrees(np.sqrt(np.mean((tilt - forecast.sight.tilt_rad)[both] ** 2)))),
        size_rms_px=float(np.sqrt(np.mean((size - forecast.sight.size_px)[both] ** 2))),
        place_rms_px=float(middle),
        speed_rms=float(np.sqrt(np.mean((speed[quick] / told[quick] - 1) ** 2))),
        differ=differ,
    )


def run(name: str, seed: int, folder: Path) -> Score:
    rig = load_rig(name)
    plan, _ = planned_motion(rig, name)
    out = folder / f"{name}{seed}"
    if not out.exists():
        capturing.capture(name, name, out, seed=seed)
    session = fitting.load_session(out)
    recording = session.recording
    start_s = recording.commanded.t_s[0]
    t_s = recording.observations.t_s - rig.table.camera.latency_s - start_s
    assert rig.table.simulation is not None
    scene = drawn_scene(rig.table, rig.table.simulation, rig.camera_model, simulate=True)
    return score(foresee(plan, scene, t_s), recording.observations)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rigs", nargs="+", default=RIGS, help="packaged rigs, each with the motion of its name")
    options.add_argument("--seeds", type=int, default=2, help="seeds 0, 1, ... of each")
    options.add_argument("--sessions", type=Path, default=None, help="keep the sessions here, and use those that are")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.sessions or Path(temporary)
        for name in chosen.rigs:
            for seed in range(chosen.seeds):
                print(f"{name} {seed}", row(run(name, seed, folder)), sep="\n", flush=True)


def row(found: Score) -> str:
    lines = [
        f"  {found.marker_frames} marker-frames, {100 * found.agree:.2f} % agree, "
        f"{100 * found.agree_far:.2f} % of those over {NEAR_FRAMES} frames from a foreseen change",
        f"  tilt {found.tilt_rms_deg:.2f} deg RMS, size {found.size_rms_px:.2f} px RMS, corners "
        f"{found.place_rms_px:.1f} px RMS, speed {100 * found.speed_rms:.1f} % RMS",
    ]
    return "\n".join([*lines, *(f"  {count:5}  {what}" for what, count in found.differ.most_common(8))])


if __name__ == "__main__":
    main()
