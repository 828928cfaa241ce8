"""How oblique, small, smeared, near to the border and covered a marker may be and still be found, on rendered frames.

Markers of 50 mm (DICT_4X4_50), white margin of one cell, f = 600 px at 640x480, blur 0.6 px, noise of 2 grey levels;
turned about random axes. The rules of station/foresight/detector.py and hiding.py are read off these rates:

- tilted: each marker's tilt goes from 40 to 90 deg and back, a degree a frame, through the tracker; the rate by px a
  cell of the narrow way (area over longest edge over 6), of all sizes and by size, up to 82 deg of tilt;
- smeared: single images, 16 instants of an exposure, tilt 30 deg, in any direction; the rate by smear [px];
- border: the rate by how far the outermost corner is from the image's border [px];
- covered: the rate by how deep [cells] a box in one grey, on the plate, covers the square from a side or at a corner.

Run: python -m tests.benchmarks.detection_limits [--seeds N]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

from calibration.intrinsics import project
from station.kinematics import se3
from station.perception.corners import MarkerDetector
from station.perception.marker_tracker import MarkerTracker
from station.simulate.render import Box, CameraOptics, Plate, SceneRenderer
from tests import rendered_markers

CAMERA = rendered_markers.webcam()
OPTICS = CameraOptics(CAMERA.size_px, CAMERA.matrix, CAMERA.distortion, blur_px=0.6, noise_grey=2.0)
SIZE_M, F_PX, CELLS = 0.05, 600.0, 6
SIZES_PX = (14, 17, 20, 24, 28, 34, 44, 60, 90)
INSTANTS = 16


def places(size_px: float, columns: int, rows: int) -> np.ndarray:
    """(M, 3) a grid in the image where markers of that size have room."""
    depth_m = F_PX * SIZE_M / size_px
    step_px = min(2.0 * size_px, 560 / columns, 400 / rows)
    x, y = (step_px * (np.arange(n) - (n - 1) / 2) / F_PX * depth_m for n in (columns, rows))
    return np.array([(px, py, depth_m) for py in y for px in x])


def renderer(ids: np.ndarray, seed: int, boxes: tuple[Box, ...] = ()) -> SceneRenderer:
    plates = [Plate(k, np.eye(4), SIZE_M, SIZE_M / CELLS, int(marker)) for k, marker in enumerate(ids)]
    return SceneRenderer(plates, boxes, rendered_markers.DICTIONARY, OPTICS, seed)


def corners(T: np.ndarray) -> np.ndarray:
    """(M, 4, 2) px."""
    return project(CAMERA, rendered_markers.corners_of(SIZE_M) @ np.swapaxes(T[:, :3, :3], -1, -2) + T[:, None, :3, 3])


def facing(tilt_deg: float | np.ndarray, at: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    azimuth, spin = rng.uniform(0, 2 * np.pi, (2, len(at)))
    return rendered_markers.facing(np.radians(tilt_deg), azimuth, spin, at)


def found(image: np.ndarray, ids: np.ndarray) -> np.ndarray:
    return np.isin(ids, MarkerDetector(rendered_markers.DICTIONARY, CAMERA).detect(image).ids)


def tilted(size_px: float, seed: int) -> np.ndarray:
    """(N, 3) px a cell the narrow way, tilt [deg], whether the tracker had it."""
    rng = np.random.default_rng(seed)
    at = places(size_px, min(max(int(350 / size_px), 1), 6), min(max(int(250 / size_px), 1), 4))
    ids = rng.permutation(50)[: len(at)]
    scene, tracker = renderer(ids, seed), MarkerTracker(rendered_markers.DICTIONARY, CAMERA, ids.tolist())
    turns = rng.uniform(0, 2 * np.pi, (2, len(at)))
    rows: list[np.ndarray] = []
    for frame, tilt in enumerate([*range(40, 90), *range(90, 40, -1)]):  # a stream: each frame needs the one before
        T = rendered_markers.facing(np.radians(min(tilt, 89.5)), *turns, at)
        seen = np.isin(ids, tracker.detect(scene.render(T, frame)).ids)
        px = corners(T)
        longest = np.linalg.norm(np.roll(px, -1, axis=1) - px, axis=-1).max(axis=1)
        x, y = px[..., 0], px[..., 1]
        area = np.abs(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)) / 2
        rows.append(np.stack([area / longest / CELLS, np.full(len(at), float(tilt)), seen], axis=-1))
    return np.concatenate(rows)


def smeared(size_px: float, smear_px: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = facing(30.0, places(size_px, 4, 3), rng)
    ids, way = rng.permutation(50)[: len(T)], rng.uniform(0, 2 * np.pi, len(T))
    share = ((np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5) * smear_px / size_px * SIZE_M
    moved = np.repeat(T[None], INSTANTS, axis=0)
    moved[:, :, :2, 3] += share[:, None, None] * np.stack([np.cos(way), np.sin(way)], axis=-1)
    return found(renderer(ids, seed).render(moved, seed), ids)


def at_border(size_px: float, from_border_px: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth_m = F_PX * SIZE_M / size_px
    T = facing(rng.uniform(0, 40, 4), np.tile([0.0, 0.0, depth_m], (4, 1)), rng)
    for marker, (axis, sign) in enumerate([(0, 1), (0, -1), (1, 1), (1, -1)]):
        T[marker, 1 - axis, 3] = rng.uniform(-0.1, 0.1) * depth_m
        for _ in range(8):  # to its place by Newton's method
            px = corners(T)[marker, :, axis]
            have = CAMERA.size_px[axis] - 0.5 - px.max() if sign > 0 else px.min() + 0.5
            T[marker, axis, 3] += sign * (have - from_border_px) / F_PX * depth_m
    ids = rng.permutation(50)[:4]
    return found(renderer(ids, seed).render(T, seed), ids)


def covered(size_px: float, deep_cells: float, seed: int, *, corner: bool) -> np.ndarray:
    rng = np.random.default_rng(seed)
    at = places(size_px, 4, 3)
    T = facing(rng.uniform(0, 40, len(at)), at, rng)
    width_m = 0.03
    x = SIZE_M / 2 - deep_cells * SIZE_M / CELLS + width_m / 2
    where = se3.translation(np.array([x, x if corner else 0.0, 0.002]))
    edges = np.array([width_m, width_m if corner else 1.5 * SIZE_M, 0.003])
    grey = int(rng.integers(20, 200))
    ids = rng.permutation(50)[: len(at)]
    boxes = tuple(Box(k, where, edges, (grey,) * 3) for k in range(len(at)))
    return found(renderer(ids, seed, boxes).render(T, seed), ids)


def line(name: str, values: tuple[float, ...], of: Callable[[float, int], np.ndarray], seeds: int) -> None:
    rates = [np.mean(np.concatenate([of(value, seed) for seed in range(seeds)])) for value in values]
    print(
        f"{name:<18}" + " ".join(f"{value:g}:{rate:.2f}" for value, rate in zip(values, rates, strict=True)), flush=True
    )


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seeds", type=int, default=3)
    seeds = options.parse_args().seeds
    by_size = {size: np.concatenate([tilted(size, seed) for seed in range(seeds)]) for size in SIZES_PX}
    together = np.concatenate(list(by_size.values()))
    print("tilted: rate by px a cell the narrow way; behind it by size [px]")
    for low in np.arange(0.8, 2.8, 0.1):
        rates = {
            size: rows[(np.abs(rows[:, 0] - low - 0.05) <= 0.05) & (rows[:, 1] <= 82), 2]
            for size, rows in {0: together, **by_size}.items()
        }
        told = " ".join(f"{size}:{rate.mean():.2f}" for size, rate in rates.items() if size and len(rate) > 20)
        print(f"{low:.1f} {rates[0].mean():.2f}  {told}")
    smears, borders = (0, 2, 4, 5, 6, 7, 8, 10, 12, 16), (0, 1, 2, 3, 4, 6, 8, 12)
    depths = (-1, -0.75, -0.5, -0.4, -0.3, -0.2, 0, 0.2, 0.3, 0.5, 0.75, 1)
    for size in (24, 34, 44, 60, 80):
        line(f"smeared, {size} px", smears, lambda value, seed, size=size: smeared(size, value, seed), seeds)
    for size in (30, 50, 80):
        line(f"border, {size} px", borders, lambda value, seed, size=size: at_border(size, value, seed), seeds)
        for corner in (False, True):
            line(
                f"{'corner' if corner else 'side'}, {size} px",
                depths,
                lambda value, seed, size=size, corner=corner: covered(size, value, seed, corner=corner),
                seeds,
            )


if __name__ == "__main__":
    main()
