"""How fast markers may go: found and how well placed by the smear that an exposure makes of their speed.

Run: python -m tests.benchmarks.motion_blur [--streams N] [--rigs]

First: four markers cross the image at even speeds, five frames at 30 a second, 12 instants of each exposure averaged in
linear light (tests/rendered_markers.py). Rates of `MarkerDetector` on each frame alone and of `MarkerTracker` on the
stream; RMS of the corners' errors [px] against those of the middle of the exposure. By smear = speed x exposure, in px
and in cells of the marker (its border included), and by exposure where that alone differs.

With --rigs: how fast the seen markers of each packaged rig go in its image during the packaged motions, which keep to
the speed that goes without saying, and what smear that is.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from calibration.intrinsics import CameraModel
from station.commands.motion_sources import read_motion
from station.logs import FloatArray
from station.motion import plan_motion
from station.perception.corners import Detections, MarkerDetector
from station.perception.marker_tracker import MarkerTracker
from station.rig import load_rig
from station.rig_reading import packaged_names
from station.simulate.scene import Plate
from station.stage import Stage
from tests.rendered_markers import CELLS, DICTIONARY, developed, facing, scene_light, true_corners, webcam

SIZE_M = 0.03
SIZES_PX = (24, 48, 72)
EXPOSURES_S = (0.008, 0.016, 0.033)
SPEEDS_PX_S = (30.0, 60.0, 90.0, 125.0, 180.0, 250.0, 350.0, 500.0)
FPS = 30.0
FRAMES = 5
INSTANTS = 12
PLACES_PX = np.array([[-85, -85], [85, -85], [-85, 85], [85, 85]])
# Upper edges of the rows: the smear in px, and in cells.
EDGES_PX = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 25.0)
EDGES_CELLS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0, 6.0)
MOTIONS = ("each_joint", "combined", "sinusoids", "explore")
STEEPEST_RAD = np.radians(75.0)


@dataclass(frozen=True)
class Sighting:
    """One marker in one frame: whether each finds it, and the RMS of its corners' errors by the detector [px]."""

    size_px: int
    exposure_s: float
    smear_px: float
    found: bool
    followed: bool
    error_px: float

    @property
    def smear_cells(self) -> float:
        """In sides of a cell."""
        return self.smear_px * CELLS / self.size_px


def stream(size_px: int, exposure_s: float, speed_px_s: float, rng: np.random.Generator) -> Iterator[Sighting]:
    """Four markers that go one way."""
    camera = webcam()
    depth_m = camera.matrix[0, 0] * SIZE_M / size_px
    each_m = SIZE_M / size_px
    ids = rng.permutation(50)[: len(PLACES_PX)]
    way = np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a), 0.0])
    centres = np.column_stack([(PLACES_PX + rng.uniform(-0.5, 0.5, PLACES_PX.shape)) * each_m, np.full(4, depth_m)])
    first = facing(np.radians(rng.uniform(0, 45, 4)), *rng.uniform(0, 2 * np.pi, (2, 4)), centres)

    def at(t_s: float) -> FloatArray:
        moved = first.copy()
        moved[:, :3, 3] += way * each_m * speed_px_s * t_s
        return moved

    detector, tracker = MarkerDetector(DICTIONARY, camera), MarkerTracker(DICTIONARY, camera, ids.tolist())
    for frame in range(FRAMES):
        t_s = (frame - (FRAMES - 1) / 2) / FPS
        instants_s = t_s + ((np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5) * exposure_s
        light = np.mean([scene_light(ids, at(each), SIZE_M, camera, rays=2) for each in instants_s], axis=0)
        image = developed(light, rng)
        found, followed = detector.detect(image), tracker.detect(image)
        truth = [true_corners(T, SIZE_M, camera) for T in at(t_s)]
        for marker_id, corners in zip(ids.tolist(), truth, strict=True):
            error_px = _error_px(found, marker_id, corners)
            smear_px = speed_px_s * exposure_s
            seen = bool(marker_id in followed.ids)
            yield Sighting(size_px, exposure_s, smear_px, bool(np.isfinite(error_px)), seen, error_px)


def _error_px(found: Detections, marker_id: int, corners: FloatArray) -> float:
    """RMS of the four corners' distances; NaN where the marker isn't found."""
    rows = np.flatnonzero(found.ids == marker_id)
    if len(rows) == 0:
        return np.nan
    return float(np.sqrt(np.mean(np.sum((found.corners_px[rows[0]] - corners) ** 2, axis=-1))))


def line(label: str, some: list[Sighting]) -> str:
    """Rates and error of some sightings."""
    if not some:
        return ""
    errors = [each.error_px for each in some if each.found]
    rms = np.sqrt(np.mean(np.square(errors))) if errors else np.nan
    rates = [100 * np.mean([getattr(each, key) for each in some]) for key in ("found", "followed")]
    return f"{label:<34} {rates[0]:7.1f} {rates[1]:7.1f} {rms:9.3f} {len(some):6}\n"


def table(sightings: list[Sighting]) -> str:
    """By size and smear in px; by smear in cells; by exposure at smears of 2 to 4 px."""
    text = f"{'':<34} {'found %':>7} {'track %':>7} {'error px':>9} {'n':>6}\n"
    for size_px in SIZES_PX:
        of = [each for each in sightings if each.size_px == size_px]
        for low, high in zip((0.0, *EDGES_PX), EDGES_PX, strict=False):
            text += line(f"{size_px} px, smear {low:g} to {high:g} px", [e for e in of if low < e.smear_px <= high])
    for low, high in zip((0.0, *EDGES_CELLS), EDGES_CELLS, strict=False):
        text += line(f"smear {low:g} to {high:g} cells", [e for e in sightings if low < e.smear_cells <= high])
    for exposure_s in EXPOSURES_S:
        some = [e for e in sightings if 2 < e.smear_px <= 4 and e.exposure_s == exposure_s and e.size_px > 24]
        text += line(f"{1e3 * exposure_s:g} ms, smear 2 to 4 px, >= 48 px", some)
    return text


def image_speeds(rig_name: str, motion_name: str) -> tuple[FloatArray, FloatArray]:
    """Speeds [px/s] and cells [px] of all seen markers, 25 times a second of a motion."""
    rig = load_rig(rig_name)
    limits = rig.table.limits()
    simulation = rig.table.simulation
    if simulation is None:
        raise ValueError(f"{rig_name} has no [simulation]")
    stage = Stage(rig.table, simulation, rig.camera_model, 0)
    plan = plan_motion(read_motion(motion_name, limits)[0], limits)
    t_s, short_s = np.arange(0.0, plan.duration_s, 0.04), 0.004
    speeds, cells = [], []
    for plate in stage.plates:
        views = [_seen(stage, plate, rig.camera_model, plan.commanded(t)) for t in (t_s, t_s + short_s)]
        px, tilt = (tuple(each) for each in zip(*views, strict=True))
        inside = np.all((px[0] > 0) & (px[0] < np.array(rig.camera_model.size_px)), axis=(-2, -1))
        seen = inside & (tilt[0] < STEEPEST_RAD)
        speeds.append(np.linalg.norm(px[1] - px[0], axis=-1).max(axis=-1)[seen] / short_s)
        cells.append(np.linalg.norm(px[0] - np.roll(px[0], 1, axis=-2), axis=-1).mean(axis=-1)[seen] / CELLS)
    return np.concatenate(speeds), np.concatenate(cells)


def _seen(stage: Stage, plate: Plate, camera: CameraModel, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners (T, 4, 2) by a pinhole camera, and tilts (T,)."""
    T = stage.T_camera_bodies(q)[:, plate.body] @ plate.T_body_marker
    s = plate.size_m / 2
    square = np.array([[-s, s, 0, 1], [s, s, 0, 1], [s, -s, 0, 1], [-s, -s, 0, 1]])
    corners = (T[:, None] @ square[..., None])[..., :3, 0]
    px = corners[..., :2] / corners[..., 2:] * camera.matrix[[0, 1], [0, 1]] + camera.matrix[:2, 2]
    sight = T[:, :3, 3] / np.linalg.norm(T[:, :3, 3], axis=-1, keepdims=True)
    return px, np.arccos(np.clip(-np.sum(sight * T[:, :3, 2], axis=-1), -1, 1))


def rig_lines(names: Iterable[str]) -> Iterator[str]:
    """A line for each rig and motion."""
    yield f"{'':<30} {'cell px':>7} {'px/s 95 %':>9} {'most':>6}   most smear in cells at 8, 16, 33 ms"
    for name in names:
        for motion in MOTIONS:
            speeds, cells = image_speeds(name, motion)
            most = [np.max(speeds / cells) * exposure_s for exposure_s in EXPOSURES_S]
            told = " ".join(f"{each:6.2f}" for each in most)
            yield (f"{name + ' ' + motion:<30} {np.median(cells):7.1f} {np.quantile(speeds, 0.95):9.0f} "
                   f"{speeds.max():6.0f}   {told}")  # fmt: skip


def main() -> None:
    """Print the tables."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--streams", type=int, default=6, help="of each size, exposure and speed")
    options.add_argument("--rigs", action="store_true", help="the packaged rigs' speeds in place of the rates")
    chosen = options.parse_args()
    if chosen.rigs:
        for each in rig_lines(packaged_names("rigs")):
            print(each, flush=True)
        return
    sightings = [
        sighting
        for size_px in SIZES_PX
        for exposure_s in EXPOSURES_S
        for speed_px_s in SPEEDS_PX_S
        for seed in range(chosen.streams)
        for sighting in stream(size_px, exposure_s, speed_px_s, np.random.default_rng([seed, size_px]))
    ]
    print(table(sightings), end="")


if __name__ == "__main__":
    main()
