from collections.abc import Callable

import cv2
import numpy as np
import pytest

from calibration.intrinsics import CameraModel, FloatArray
from station.perception.profiles import LIGHT_MARGIN_PX, linear_light
from station.perception.refinement import refine_corners
from station.quadrilaterals import edges_of, intersect_edges
from tests.rendered_markers import marker_bits

SIZE_M = 0.05
# Rough corners are off by up to this.
ROUGH_PX = 1.0


def inner_bits(ids: np.ndarray) -> FloatArray:
    """(M, 4, 6) bits behind the border along the edges, clockwise from the top."""
    bits = [marker_bits(int(i)) for i in ids]
    return np.array([[b[1], b[:, -2], b[-2, ::-1], b[::-1, 1]] for b in bits])


@pytest.fixture(scope="module")
def scene(camera: CameraModel, render: Callable, pose_facing: Callable, project_corners: Callable) -> Callable:
    """scene(tilt_deg, distance_m, seed, ...) -> image of six markers, their ids, true and rough corners (6, 4, 2)."""

    def make(tilt_deg: float, distance_m: float, seed: int, **rendering: float) -> tuple[np.ndarray, ...]:
        rng = np.random.default_rng(seed)
        places = [(x * distance_m, y * distance_m, distance_m) for y in (-0.17, 0.17) for x in (-0.33, 0.0, 0.33)]
        T = np.stack([pose_facing(np.deg2rad(tilt_deg), *rng.uniform(0, 2 * np.pi, 2), p) for p in places])
        ids = rng.permutation(50)[:6]
        truth = np.stack([project_corners(pose, SIZE_M, camera) for pose in T])
        image = render(ids, T, SIZE_M, camera, rng, rays=4, **rendering)
        return image, ids, truth, truth + rng.uniform(-ROUGH_PX, ROUGH_PX, truth.shape)

    return make


def by_even_shift(truth: FloatArray) -> FloatArray:
    """Motions (M, 4, 2) of the corners where all edges move outward by one amount, those of narrow borders too: what
    line fits are off by at oblique views.
    """
    return intersect_edges(edges_of(truth).normal, np.ones(truth.shape[:2]))


def without_shared_shift(error: FloatArray, truth: FloatArray) -> FloatArray:
    """Errors (M, 4, 2) less the part that a shift of all edges by one amount explains."""
    J = by_even_shift(truth)
    return error - np.sum(error * J) / np.sum(J * J) * J


def normalised_squares(error: FloatArray, covariance: FloatArray, truth: FloatArray) -> FloatArray:
    """e^T C^-1 e / 2 (M, 4) of errors (M, 4, 2) less the likeliest shared shift of all edges."""
    J, information = by_even_shift(truth), np.linalg.inv(covariance)
    weighted = np.einsum("mei,meij->mej", J, information)
    rest = error - np.sum(weighted * error) / np.sum(weighted * J) * J
    return np.einsum("mei,meij,mej->me", rest, information, rest) / 2


@pytest.mark.parametrize(("tilt_deg", "distance_m"), [(0, 0.3), (30, 0.6), (60, 0.9), (75, 0.6)])
def test_stated_covariances_are_honest(
    scene: Callable, camera: CameraModel, tilt_deg: float, distance_m: float
) -> None:
    squared = []
    for seed in range(6):
        noise = (1.0, 4.0)[seed % 2]
        image, ids, truth, rough = scene(tilt_deg, distance_m, seed, noise_grey=noise, blur_px=0.5 + 0.1 * seed)
        found = refine_corners(image, rough, inner_bits(ids), camera)
        squared.append(normalised_squares(found.corners_px - truth, found.covariance_px2, truth))
        assert np.all(found.good)
    # 144 corners, those of a marker sharing edges: the mean of chi-squared of 2 over 2 is 1 +- 0.1.
    assert 0.7 < np.mean(squared) < 1.4


def test_covariance_grows_with_noise_blur_and_obliquity(scene: Callable, camera: CameraModel) -> None:
    def variance(tilt_deg: float, **rendering: float) -> float:
        image, ids, _, rough = scene(tilt_deg, 0.6, 3, **rendering)
        found = refine_corners(image, rough, inner_bits(ids), camera)
        return float(np.median(np.trace(found.covariance_px2, axis1=-2, axis2=-1)))

    plain = variance(20)
    assert variance(20, noise_grey=8.0) > 4 * plain
    assert variance(20, blur_px=1.6, noise_grey=4.0) > 1.3 * variance(20, noise_grey=4.0)
    assert variance(70) > 2 * plain


def test_the_lens_bends_long_edges_and_a_known_camera_straightens_them(scene: Callable, camera: CameraModel) -> None:
    image, ids, truth, rough = scene(0, 0.3, 1, noise_grey=0.5)
    errors = [refine_corners(image, rough, inner_bits(ids), known).corners_px - truth for known in (camera, None)]
    known, unknown = (float(np.sqrt(np.mean(without_shared_shift(e, truth) ** 2))) for e in errors)
    assert known < 0.012  # px; 0.006 measured
    assert unknown > 1.5 * known


def test_a_narrow_border_before_white_cells_does_not_pull_the_edge(scene: Callable, camera: CameraModel) -> None:
    image, ids, truth, rough = scene(60, 1.0, 2, noise_grey=0.5)  # borders of 2.5 px
    found = refine_corners(image, rough, inner_bits(ids), camera)
    ignorant = refine_corners(image, rough, np.zeros((6, 4, 6)), camera)
    known, unknown = (
        float(np.sqrt(np.mean(without_shared_shift(f.corners_px - truth, truth) ** 2))) for f in (found, ignorant)
    )
    assert known < 0.04  # px
    assert unknown > 1.5 * known


def test_blur_is_measured(scene: Callable, camera: CameraModel) -> None:
    for blur_px in (0.7, 1.5):
        image, ids, _, rough = scene(10, 0.6, 4, blur_px=blur_px)
        found = refine_corners(image, rough, inner_bits(ids), camera)
        # The pixel's own width (1/12) and that of bilinear reading (1/6) add to the blur's variance.
        np.testing.assert_allclose(found.blur_px, np.sqrt(blur_px**2 + 0.25), atol=0.06)


def test_faint_squares_are_no_markers(scene: Callable) -> None:
    image, ids, truth, _ = scene(20, 0.6, 5)
    faint = np.clip(128 + 0.02 * (image.astype(float) - 128), 0, 255).astype(np.uint8)
    assert not np.any(refine_corners(faint, truth, inner_bits(ids)).good)


def test_refining_leaves_what_it_rejects_as_it_came(scene: Callable) -> None:
    image, ids, truth, _ = scene(20, 0.6, 6)
    for elsewhere in (truth + 40.0, truth + 1e5):
        kept = refine_corners(image, elsewhere, inner_bits(ids))
        assert not np.any(kept.good)
        np.testing.assert_array_equal(kept.corners_px, elsewhere)


def test_markers_do_not_influence_each_other(scene: Callable, camera: CameraModel) -> None:
    image, ids, _, rough = scene(30, 0.6, 7)
    together = refine_corners(image, rough, inner_bits(ids), camera)
    alone = refine_corners(image, rough[2:3], inner_bits(ids[2:3]), camera)
    np.testing.assert_allclose(alone.corners_px[0], together.corners_px[2], atol=1e-6)  # px; single precision
    np.testing.assert_allclose(alone.covariance_px2[0], together.covariance_px2[2], rtol=1e-3)


def test_what_a_blurred_marker_shows_on_a_plain_card_is_enough(camera: CameraModel, project_corners: Callable) -> None:
    """A marker that fills the image, so that its edges lie at the very border: nothing of them may be made up."""
    image = np.full((480, 640), 200, np.uint8)
    cv2.rectangle(image, (0, 100), (200, 300), 20, -1)
    corners = np.array([[[-0.5, 99.5], [200.5, 99.5], [200.5, 300.5], [-0.5, 300.5]]])
    assert not refine_corners(image, corners, np.zeros((1, 4, 6)), camera).good[0]


def test_a_smear_is_in_the_covariance_or_the_marker_is_dropped(scene: Callable, camera: CameraModel) -> None:
    squared, told = [], []
    for seed in range(8):
        image, ids, truth, rough = scene(20, 0.6, seed, noise_grey=1.0)
        smeared = cv2.blur((image / 255.0) ** 2.2, (7, 1))  # in linear light, as motion along the rows does
        seen = np.round(255 * smeared ** (1 / 2.2)).astype(np.uint8)
        found = refine_corners(seen, rough, inner_bits(ids), camera)
        error = found.corners_px - truth
        squared.append(normalised_squares(error[found.good], found.covariance_px2[found.good], truth[found.good]))
        told.append(np.abs(error[found.good]).max(initial=0.0))
    assert 0.2 < np.concatenate(squared).mean() < 1.5  # 2.3 without the smear's part
    assert max(told) < 0.3  # px


def test_what_is_not_decoded_is_black() -> None:
    square = np.array([[[100.0, 100], [150, 100], [150, 150], [100, 150]]])
    around = slice(100 - LIGHT_MARGIN_PX, 150 + LIGHT_MARGIN_PX + 1)
    for _ in range(3):
        np.full((480, 640), np.inf, dtype=np.float32)  # memory that was used before
        light = linear_light(np.full((480, 640), 200, np.uint8), square)
        assert np.all(light[around, around] > 0.5)
        light[around, around] = 0.0
        assert not np.any(light)
