from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from calibration.intrinsics import CameraModel, FloatArray
from station.errors import InvalidData
from station.perception.corners import Detections, MarkerDetector
from station.quadrilaterals import edge_shift_jacobian, edge_shift_shares, shift_edges, unshift_edges

SIZE_M = 0.05
CELLS = 6
Views = list[tuple[np.ndarray, FloatArray]]


@pytest.fixture(scope="module")
def views(camera: CameraModel, render: Callable, pose_facing: Callable, project_corners: Callable) -> Callable:
    """views(tilts_deg, seed, ...) -> images of six markers 0.6 m away, with the true corners (6, 4, 2)."""

    def make(tilts_deg: Sequence[float], seed: int, **rendering: float) -> Views:
        rng = np.random.default_rng(seed)
        out = []
        for tilt_deg in tilts_deg:
            places = [(x, y, 0.6) for y in (-0.1, 0.1) for x in (-0.2, 0.0, 0.2)]
            T = np.stack(
                [
                    pose_facing(np.deg2rad(tilt_deg), *rng.uniform(0, 2 * np.pi, 2), p + rng.uniform(-0.01, 0.01, 3))
                    for p in np.array(places)
                ]
            )
            truth = np.stack([project_corners(pose, SIZE_M, camera) for pose in T])
            out.append((render(range(6), T, SIZE_M, camera, rng, **rendering), truth))
        return out

    return make


@pytest.fixture(scope="module")
def view(views: Callable) -> tuple[np.ndarray, FloatArray]:
    """An image of six markers at 20 deg, and its true corners (6, 4, 2)."""
    (seen,) = views([20], seed=10)
    return seen


@pytest.fixture(scope="module")
def detector() -> MarkerDetector:
    return MarkerDetector("DICT_4X4_50")


def errors_px(detect: Callable[[np.ndarray], Detections], views: Views) -> FloatArray:
    """(N, 4, 2) errors of all corners found."""
    found = [(detect(image), truth) for image, truth in views]
    return np.concatenate([d.corners_px - truth[d.ids] for d, truth in found])


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def unrefined(image: np.ndarray) -> Detections:
    plain = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    corners, ids, _ = plain.detectMarkers(image)
    covariance_px2 = np.full((len(corners), 4, 2, 2), np.nan)
    return Detections(np.reshape(ids, -1), np.reshape(corners, (-1, 4, 2)).astype(np.float64), covariance_px2)


@pytest.mark.parametrize("tilt_deg", [0, 30, 60])
def test_corners_are_right_to_a_few_hundredths_of_a_pixel(views: Callable, detector: MarkerDetector, tilt_deg) -> None:
    seen = views([tilt_deg] * 2, seed=tilt_deg)
    errors = errors_px(detector.detect, seen)
    assert len(errors) == 12  # every marker found
    assert rms(errors) < 0.04  # px; 0.017 to 0.022 measured
    assert rms(errors_px(unrefined, seen)) > 10 * rms(errors)


@pytest.mark.parametrize("rendering", [{"blur_px": 0.3}, {"blur_px": 1.2}, {"noise_grey": 5.0}], ids=str)
def test_blur_and_noise_cost_little(views: Callable, detector: MarkerDetector, rendering: dict[str, float]) -> None:
    errors = errors_px(detector.detect, views([30, 40], seed=7, **rendering))
    assert len(errors) >= 10  # of 12; OpenCV itself misses some of those that are blurred
    assert rms(errors) < 0.06  # px; 0.02 to 0.04 measured


def test_the_black_square_looks_neither_smaller_nor_larger(views: Callable, detector: MarkerDetector) -> None:
    seen = views([20, 40], seed=8)
    radial = []
    for image, truth in seen:
        d = detector.detect(image)
        out = truth[d.ids] - truth[d.ids].mean(axis=1, keepdims=True)
        out /= np.linalg.norm(out, axis=-1, keepdims=True)
        radial.append(np.sum(out * (d.corners_px - truth[d.ids]), axis=-1))
    assert abs(np.mean(radial)) < 0.015  # px, along the diagonals; -0.9 px without refinement, 0.003 measured


def test_colour_and_grey_images_give_the_same(view: tuple[np.ndarray, FloatArray], detector: MarkerDetector) -> None:
    image, _ = view
    grey, colour = detector.detect(image), detector.detect(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    np.testing.assert_array_equal(grey.ids, colour.ids)
    np.testing.assert_allclose(grey.corners_px, colour.corners_px, atol=1e-9)


def test_an_image_without_markers_has_none(detector: MarkerDetector) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (480, 640), dtype=np.uint8)
    for image in (np.full((480, 640), 128, np.uint8), noise):
        found = detector.detect(image)
        assert (len(found), found.corners_px.shape) == (0, (0, 4, 2))


def test_a_marker_partly_hidden_is_dropped(view: tuple[np.ndarray, FloatArray], detector: MarkerDetector) -> None:
    image, truth = view[0].copy(), view[1]
    middle = truth[0, :2].mean(axis=0)  # a finger over a part of one edge
    cv2.circle(image, tuple(int(c) for c in middle), 9, 150, -1)
    found = detector.detect(image)
    assert 0 not in found.ids
    assert len(found) == 5


def test_an_id_seen_twice_is_dropped(camera: CameraModel, render: Callable, pose_facing: Callable, detector) -> None:
    T = np.stack([pose_facing(0.3, 0.0, 0.0, (x, 0.0, 0.6)) for x in (-0.15, 0.0, 0.15)])
    image = render([4, 5, 4], T, SIZE_M, camera, np.random.default_rng(0))
    assert detector.detect(image).ids.tolist() == [5]


def test_shifted_edges_lie_that_far_out() -> None:
    square = np.array([[[10.0, 10], [90, 10], [90, 90], [10, 90]]])
    out = [[9.7, 9.7], [90.3, 9.7], [90.3, 90.3], [9.7, 90.3]]
    np.testing.assert_allclose(shift_edges(square, 0.3)[0], out, atol=1e-5)
    skew = np.array([[[10.0, 12], [55, 9], [49, 60], [8, 40]]])
    np.testing.assert_allclose(unshift_edges(shift_edges(skew, 0.4), 0.4), skew, atol=1e-8)


def test_edges_of_a_narrow_border_show_less_of_the_shift() -> None:
    high, narrow_px = 60.0, np.array([9.0, 19.2, 24.0, 42.0])
    of_width = np.array([[[0.0, 0.0], [w, 0.0], [w, high], [0.0, high]] for w in narrow_px])
    shares = edge_shift_shares(of_width)
    np.testing.assert_allclose(shares[:, [0, 2]], 1.0, atol=1e-3)  # across them the marker is 60 px wide
    np.testing.assert_allclose(shares[:, 1], [0.09, 0.5, 0.74, 0.99], atol=0.01)
    np.testing.assert_allclose(shares[:, 1], shares[:, 3])


@pytest.mark.parametrize("image", [np.zeros((4, 4)), np.zeros((4, 4, 4), np.uint8), np.zeros(4, np.uint8)], ids=str)
def test_what_is_no_image_is_refused(detector: MarkerDetector, image: np.ndarray) -> None:
    with pytest.raises(InvalidData, match="want uint8"):
        detector.detect(image)


def clutter(rng: np.random.Generator) -> list[np.ndarray]:
    """Images without markers: coarse noise, text, chequers, rectangles."""
    noise = [
        cv2.resize(rng.integers(0, 255, (480 // g, 640 // g), dtype=np.uint8), (640, 480), interpolation=mode)
        for g, mode in ((4, cv2.INTER_CUBIC), (16, cv2.INTER_NEAREST))
    ]
    text, boxes = np.full((2, 480, 640), 230, np.uint8)
    for y in range(20, 480, 24):
        line = "".join(chr(c) for c in rng.integers(33, 127, 60))
        cv2.putText(text, line, (4, y), cv2.FONT_HERSHEY_SIMPLEX, 0.7, 20, 2)
    for x, y, width, height in rng.integers(8, 90, (80, 4)) * (7, 5, 1, 1):
        cv2.rectangle(boxes, (int(x), int(y)), (int(x + width), int(y + height)), int(rng.integers(0, 255)), -1)
    rows, columns = np.indices((480, 640)) // int(rng.integers(8, 40))
    return [*noise, text, boxes, np.where((rows + columns) % 2, 30, 220).astype(np.uint8)]


def test_clutter_shows_no_markers(detector: MarkerDetector) -> None:
    rng = np.random.default_rng(1)
    for image in (image for _ in range(4) for image in clutter(rng)):
        assert not len(detector.detect(image))


def test_a_marker_cut_by_the_border_is_none(view: tuple[np.ndarray, FloatArray], detector: MarkerDetector) -> None:
    image, truth = view
    middle = truth[0].mean(axis=0)
    right = int(middle[0]) + 15  # the image's new border runs through the marker, and through another
    found = detector.detect(np.ascontiguousarray(image[:, :right]))
    assert 0 not in found.ids
    # One at the border loses its margin, not its edges: what is reported must still be right.
    top_left = truth[1].min(axis=0)
    cut = np.ascontiguousarray(image[:, int(top_left[0]) - 2 :])
    found = detector.detect(cut)
    for marker, corners in zip(found.ids, found.corners_px, strict=True):
        np.testing.assert_allclose(corners + np.array([int(top_left[0]) - 2, 0]), truth[marker], atol=0.2)  # px


def test_blurred_and_small_markers_are_found(views: Callable, detector: MarkerDetector) -> None:
    seen = views([20, 40], seed=11, blur_px=2.2)
    found = [len(detector.detect(image)) for image, _ in seen]
    assert sum(found) >= 11  # of 12; OpenCV finds 5
    quick = [len(detector.detect(image, expected=())) for image, _ in seen]
    assert sum(quick) <= sum(found)


def test_a_missing_marker_makes_the_search_full(
    view: tuple[np.ndarray, FloatArray], detector: MarkerDetector, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, _ = view
    made: list[int] = []
    original = detector.search_fully
    monkeypatch.setattr(detector, "search_fully", lambda grey: (made.append(1), original(grey))[1])
    assert len(detector.detect(image, expected=range(6))) == 6
    assert not made
    detector.detect(image, expected=(0, 44))
    assert made


def test_the_signature_of_an_edge_shift_is_what_shifting_does() -> None:
    skew = np.array([[[10.0, 12], [55, 9], [49, 60], [8, 40]]])
    np.testing.assert_allclose(shift_edges(skew, 0.3) - skew, 0.3 * edge_shift_jacobian(skew), atol=1e-12)
