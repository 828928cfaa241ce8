"""Corners on rendered frames with known truth (cv2.projectPoints), beside OpenCV's four methods; false positives.

Markers of 50 mm (DICT_4X4_50, white margin of one cell on grey), f = 600 px at 640x480, a webcam's distortion, which
the detector knows; blur 0.7 px and noise of 2 grey levels unless the row says otherwise. Each cell: the rate of markers
found, the shift of all edges outward that the cell's corners share (px), the random error (RMS of a coordinate when
that shift is taken off, px), and for ours the mean of e^T C^-1 e / 2 with the stated covariances C: 1 if they are
honest; ~ marks those outside 0.8 to 1.25. The rates are those of single images: `MarkerDetector.detect`.

False positives: markers reported per 1000 images without any (noise of several grains, text, chequers, rectangles,
blobs), by OpenCV with default parameters, and by ours.

Run: python -m tests.benchmarks.corners [--seed N] [--images N] [--clutter N]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np

from calibration.intrinsics import FloatArray
from station.perception.corners import MarkerDetector
from station.quadrilaterals import edge_shift_jacobian
from tests import rendered_markers

SIZE_M = 0.05
CAMERA = rendered_markers.webcam()
TILTS_DEG = (0, 30, 45, 60, 70, 75)
DISTANCES_M = (0.3, 0.6, 0.9, 1.2)
HONEST = (0.8, 1.25)
NEAR_M = 0.75
MATCH_PX = 3.0  # a corner further from the truth is another thing
REFINEMENTS = {
    "none": cv2.aruco.CORNER_REFINE_NONE,
    "subpix": cv2.aruco.CORNER_REFINE_SUBPIX,
    "contour": cv2.aruco.CORNER_REFINE_CONTOUR,
    "apriltag": cv2.aruco.CORNER_REFINE_APRILTAG,
}
DICTIONARIES = ("DICT_4X4_50", "DICT_4X4_1000", "DICT_5X5_250", "DICT_6X6_250", "DICT_APRILTAG_16h5")

Image = np.ndarray
# Ids, corners (M, 4, 2) and their covariances, if there are any.
Found = tuple[np.ndarray, FloatArray, FloatArray | None]


@dataclass(frozen=True)
class Condition:
    """How frames are made from light."""

    name: str
    developing: dict[str, float] = field(default_factory=dict)
    jpeg: int | None = None


CONDITIONS = (
    Condition("as usual"),
    Condition("blur 0.3", {"blur_px": 0.3}),
    Condition("blur 1.2", {"blur_px": 1.2}),
    Condition("blur 1.8", {"blur_px": 1.8}),
    Condition("noise 6", {"noise_grey": 6.0}),
    Condition("JPEG 50", jpeg=50),
    Condition("gamma 1.8", {"gamma": 1.8}),
    Condition("gamma 2.4", {"gamma": 2.4}),
)


@dataclass(frozen=True, eq=False)
class View:
    """Light (H, W) of markers, their ids and true corners (M, 4, 2)."""

    light: FloatArray
    ids: np.ndarray
    truth: FloatArray


def view(tilt_deg: float, distance_m: float, rng: np.random.Generator) -> View:
    """Markers all over the image: six near ones, 24 far ones."""
    near = distance_m < 0.75
    x, y = (
        (np.linspace(-0.33, 0.33, 3), (-0.167, 0.167))
        if near
        else (np.linspace(-0.4, 0.4, 6), (-0.27, -0.09, 0.09, 0.27))
    )
    places = np.array([(px, py, 1.0) for py in y for px in x]) * distance_m
    places += rng.uniform(-0.01, 0.01, places.shape) * distance_m
    turns = rng.uniform(0, 2 * np.pi, (len(places), 2))
    T = np.stack(
        [rendered_markers.facing(np.radians(tilt_deg), *turn, place) for turn, place in zip(turns, places, strict=True)]
    )
    ids = rng.permutation(50)[: len(T)]
    truth = np.stack([rendered_markers.true_corners(pose, SIZE_M, CAMERA) for pose in T])
    return View(rendered_markers.scene_light(ids, T, SIZE_M, CAMERA), ids, truth)


def frame(light: FloatArray, condition: Condition, rng: np.random.Generator) -> Image:
    image = rendered_markers.developed(light, rng, **condition.developing)
    if condition.jpeg is None:
        return image
    return cv2.imdecode(
        cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, condition.jpeg])[1], cv2.IMREAD_GRAYSCALE
    )


def opencv(refinement: int) -> Callable[[Image], Found]:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = refinement
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), parameters)

    def detect(image: Image) -> Found:
        corners, ids, _ = detector.detectMarkers(image)
        count = 0 if ids is None else len(ids)
        return np.reshape(ids if count else [], -1).astype(int), np.reshape(corners, (count, 4, 2)).astype(float), None

    return detect


def ours() -> Callable[[Image], Found]:
    detector = MarkerDetector(rendered_markers.DICTIONARY, CAMERA)

    def detect(image: Image) -> Found:
        found = detector.detect(image)
        return found.ids, found.corners_px, found.covariance_px2

    return detect


@dataclass(frozen=True)
class Score:
    """Of one method in one cell."""

    rate: float
    shift_px: float
    random_px: float
    normalised: float

    def text(self) -> str:
        if not self.rate:
            return "0.00                  "
        return f"{self.rate:4.2f} {self.shift_px:+6.3f} {self.random_px:6.3f}"


def score(finds: list[Found], views: list[View]) -> Score:
    errors, motions, covariances = [], [], []
    for (ids, corners, covariance), seen in zip(finds, views, strict=True):
        for row, marker in enumerate(ids):
            true = seen.truth[np.flatnonzero(seen.ids == marker)]
            if len(true) and np.abs(corners[row] - true[0]).max() < MATCH_PX:
                errors.append(corners[row] - true[0])
                motions.append(edge_shift_jacobian(true)[0])
                covariances.append(np.full((4, 2, 2), np.nan) if covariance is None else covariance[row])
    shown = sum(len(seen.ids) for seen in views)
    if not errors:
        return Score(0.0, np.nan, np.nan, np.nan)
    e, J, C = np.stack(errors), np.stack(motions), np.stack(covariances)
    shift = np.sum(e * J) / np.sum(J * J)
    information = np.linalg.inv(C)
    weighted = np.einsum("mei,meij->mej", J, information)
    rest = e - np.sum(weighted * e) / np.sum(weighted * J) * J
    normalised = np.einsum("mei,meij,mej->me", rest, information, rest).mean() / 2
    return Score(len(e) / shown, float(shift), float(np.sqrt(np.mean((e - shift * J) ** 2))), float(normalised))


def cell_views(distance_m: float, tilt_deg: int, images: int, seed: int) -> list[View]:
    count = images if distance_m < NEAR_M else max(images // 3, 1)
    seeds = [[seed, round(100 * distance_m), tilt_deg, n] for n in range(count)]
    return [view(tilt_deg, distance_m, np.random.default_rng(each)) for each in seeds]


def row(name: str, cell: tuple[float, int], scores: dict[str, Score]) -> str:
    honest = scores["ours"].normalised
    mark = " " if HONEST[0] <= honest <= HONEST[1] or np.isnan(honest) else "~"
    others = " | ".join(each.text() for method, each in scores.items() if method != "ours")
    return f"{name:<10} {cell[0]:3.1f} m {cell[1]:3d}° {scores['ours'].text()} {honest:6.2f}{mark} | {others}"


def accuracy(images: int, seed: int) -> None:
    methods = {"ours": ours(), **{name: opencv(refinement) for name, refinement in REFINEMENTS.items()}}
    # With all tilts and distances of a condition below each other; light is made once for all conditions.
    cells = [(distance, tilt) for distance in DISTANCES_M for tilt in TILTS_DEG]
    views = {cell: cell_views(*cell, images, seed) for cell in cells}
    print("rate, shift px, random px (and e'C^-1 e / 2 of ours)")
    print(f"{'':22}" + "".join(f"{name:<{32 if name == 'ours' else 24}}" for name in methods))
    for condition in CONDITIONS:
        for cell in cells:
            rng = np.random.default_rng(seed)
            frames = [frame(seen.light, condition, rng) for seen in views[cell]]
            scores = {name: score([detect(image) for image in frames], views[cell]) for name, detect in methods.items()}
            print(row(condition.name, cell, scores), flush=True)


def clutter(kind: int, rng: np.random.Generator) -> Image:
    """An image (480, 640) without markers, of one of six kinds."""
    size = (480, 640)
    if kind < 3:  # noise of ever coarser grain, at full contrast
        grain = (1, 6, 20)[kind]
        coarse = rng.integers(0, 256, (size[0] // grain + 1, size[1] // grain + 1), dtype=np.uint8)
        return cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC if kind == 1 else cv2.INTER_NEAREST)
    image = np.full(size, 230, np.uint8)
    if kind == 3:
        for y in range(20, 480, 24):
            text = "".join(chr(c) for c in rng.integers(33, 127, 60))
            cv2.putText(image, text, (4, y), cv2.FONT_HERSHEY_SIMPLEX, rng.uniform(0.4, 1.0), 20, 2)
    elif kind == 4:
        cell = int(rng.integers(8, 60))
        rows, columns = np.indices(size) // cell
        image[(rows + columns) % 2 == 0] = 30
    else:
        for _ in range(120):
            box = cv2.RotatedRect(rng.uniform((0, 0), (640, 480)), rng.uniform(8, 90, 2), rng.uniform(0, 90))
            cv2.fillPoly(image, [box.points().astype(np.int32)], int(rng.integers(0, 256)))
    return cv2.GaussianBlur(image, (0, 0), 0.7)


def false_positives(images: int, seed: int) -> None:
    print(f"\nfalse positives per 1000 images, of {6 * images} images: OpenCV, ours")
    for name in DICTIONARIES:
        plain = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)))
        detector, rng = MarkerDetector(name), np.random.default_rng(seed)
        counts = np.zeros(2)
        for n in range(6 * images):
            image = clutter(n % 6, rng)
            ids = plain.detectMarkers(image)[1]
            counts[0] += 0 if ids is None else len(ids)
            counts[1] += len(detector.detect(image))
        print(f"{name:<20}" + "".join(f"{1000 * count / (6 * images):8.1f}" for count in counts), flush=True)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--images", type=int, default=6, help="in a cell of near markers; a third of it far away")
    options.add_argument("--clutter", type=int, default=20, help="images of each kind without markers")
    chosen = options.parse_args()
    cv2.setNumThreads(1)
    accuracy(chosen.images, chosen.seed)
    false_positives(chosen.clutter, chosen.seed)


if __name__ == "__main__":
    main()
