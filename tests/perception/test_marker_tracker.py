"""Streams of frames: what is followed, what is found again, and what single images show."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from calibration.intrinsics import CameraModel, FloatArray
from station.perception.corners import MarkerDetector
from station.perception.marker_bits import behind_border, dictionary_bits, shows_bits
from station.perception.marker_tracker import (
    FULL_AT_LEAST_EVERY_FRAMES,
    FULL_EVERY_FRAMES,
    SEARCH_EVERY_FRAMES,
    MarkerTracker,
)
from tests.rendered_markers import DICTIONARY, marker_bits

SIZE_M = 0.05
IDS = (3, 8, 21)


@pytest.fixture(scope="module")
def seen(camera: CameraModel, render: Callable, pose_facing: Callable, project_corners: Callable) -> Callable:
    """seen(x_m, ids=..., **rendering) -> image of markers around x_m, and their true corners (M, 4, 2)."""

    def make(x_m: float, ids: tuple[int, ...] = IDS, **rendering: float) -> tuple[np.ndarray, FloatArray]:
        T = np.stack([pose_facing(0.4, 0.3, 0.2, (x_m + 0.12 * (m - 1), 0.0, 0.6)) for m in range(len(ids))])
        image = render(ids, T, SIZE_M, camera, np.random.default_rng(0), rays=3, **rendering)
        return image, np.stack([project_corners(pose, SIZE_M, camera) for pose in T])

    return make


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The searches of whole images, by name, as they are made."""
    made: list[str] = []
    for name in ("search", "search_fully"):
        original = getattr(MarkerDetector, name)

        def counted(self: MarkerDetector, grey: np.ndarray, name: str = name, original: Callable = original):
            made.append(name)
            return original(self, grey)

        monkeypatch.setattr(MarkerDetector, name, counted)
    return made


def test_moving_markers_are_followed_without_a_search(seen: Callable, camera: CameraModel, searches: list[str]) -> None:
    tracker = MarkerTracker(DICTIONARY, camera, IDS)
    for n in range(SEARCH_EVERY_FRAMES - 1):
        image, truth = seen(-0.03 + 0.004 * n)  # 4 px a frame
        found = tracker.detect(image)
        assert sorted(found.ids.tolist()) == sorted(IDS)
        order = np.argsort(np.argsort(IDS))
        np.testing.assert_allclose(found.corners_px[np.argsort(found.ids)][order], truth, atol=0.1)  # px
    # The first frame is searched; in the second, nothing is known of the motion yet.
    assert searches.count("search_fully") == 1
    assert len(searches) <= 3


def test_a_stream_gives_the_corners_that_single_images_give(seen: Callable, camera: CameraModel) -> None:
    tracker, detector = MarkerTracker(DICTIONARY, camera, IDS), MarkerDetector(DICTIONARY, camera)
    for n in range(4):
        image, _ = seen(0.003 * n)
        followed, alone = tracker.detect(image), detector.detect(image, IDS)
        by_id = np.argsort(followed.ids), np.argsort(alone.ids)
        np.testing.assert_array_equal(followed.ids[by_id[0]], alone.ids[by_id[1]])
        # px: both start from elsewhere, and what is left of that is far below the corners' own error
        np.testing.assert_allclose(followed.corners_px[by_id[0]], alone.corners_px[by_id[1]], atol=0.02)


def test_a_marker_that_comes_back_is_found_at_once(seen: Callable, camera: CameraModel) -> None:
    tracker = MarkerTracker(DICTIONARY, camera, IDS)
    tracker.detect(seen(0.0)[0])
    assert len(tracker.detect(seen(0.0, IDS[:2])[0])) == 2
    assert len(tracker.detect(seen(0.05)[0])) == 3


def test_a_marker_that_nobody_expects_is_found_with_the_next_search(seen: Callable, camera: CameraModel) -> None:
    tracker = MarkerTracker(DICTIONARY, camera)
    for _ in range(3):
        tracker.detect(seen(0.0, IDS[:2])[0])
    counts = [len(tracker.detect(seen(0.0)[0])) for _ in range(SEARCH_EVERY_FRAMES)]
    assert counts[-1] == 3


def test_what_only_the_full_search_finds_is_missed_for_few_frames(seen: Callable, camera: CameraModel) -> None:
    blank = np.full((480, 640), 150, np.uint8)
    image, _ = seen(0.0)
    for expected, most in ((IDS, FULL_EVERY_FRAMES), (None, FULL_AT_LEAST_EVERY_FRAMES)):
        tracker = MarkerTracker(DICTIONARY, camera, expected)
        nothing = tracker._detector.search(blank)
        tracker._detector.search = lambda grey, nothing=nothing: nothing  # type: ignore[method-assign]
        tracker.detect(blank)
        missed = next(n for n in range(1000) if len(tracker.detect(image)) == 3)
        assert missed <= most - 1


def test_the_full_search_is_not_made_for_each_frame_that_lacks_a_marker(
    seen: Callable, camera: CameraModel, searches: list[str]
) -> None:
    tracker, image = MarkerTracker(DICTIONARY, camera, (*IDS, 40)), seen(0.0)[0]
    for _ in range(2 * FULL_EVERY_FRAMES):
        tracker.detect(image)
    assert searches.count("search_fully") == 2


def test_a_followed_marker_that_is_swapped_for_another_is_not_taken_for_it(seen: Callable, camera: CameraModel) -> None:
    tracker = MarkerTracker(DICTIONARY, camera)
    tracker.detect(seen(0.0)[0])
    swapped = tracker.detect(seen(0.0, (3, 30, 21))[0])
    assert sorted(swapped.ids.tolist()) == [3, 21, 30]


def test_frames_without_markers_give_none_and_the_same_frames_the_same(seen: Callable, camera: CameraModel) -> None:
    frames = [seen(0.004 * n)[0] for n in range(4)] + [np.full((480, 640), 90, np.uint8)] * 2
    runs = []
    for _ in range(2):
        tracker = MarkerTracker(DICTIONARY, camera)
        runs.append([tracker.detect(frame) for frame in frames])
    assert [len(found) for found in runs[0]] == [3, 3, 3, 3, 0, 0]
    for first, second in zip(*runs, strict=True):
        np.testing.assert_array_equal(first.corners_px, second.corners_px)
        np.testing.assert_array_equal(first.covariance_px2, second.covariance_px2)


def test_the_bits_of_the_dictionary_are_those_that_it_draws() -> None:
    bits = dictionary_bits(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    for marker in (0, 17, 49):
        np.testing.assert_array_equal(bits[marker], marker_bits(marker))
    top, right, bottom, left = behind_border(bits)[17]
    np.testing.assert_array_equal(top, bits[17, 1])
    np.testing.assert_array_equal(right, bits[17, :, -2])
    np.testing.assert_array_equal(bottom, bits[17, -2, ::-1])
    np.testing.assert_array_equal(left, bits[17, ::-1, 1])


def test_a_marker_shows_its_own_bits_in_perspective_and_no_others(seen: Callable) -> None:
    image, truth = seen(0.0)
    expected = np.stack([marker_bits(marker) for marker in IDS])
    assert np.all(shows_bits(image, truth, expected))
    for turned in (1, 2, 3):
        assert not np.any(shows_bits(image, truth, np.rot90(expected, turned, axes=(1, 2))))
    flipped = expected.copy()
    flipped[:, 2, 2] = 1 - flipped[:, 2, 2]
    assert not np.any(shows_bits(image, truth, flipped))
    assert not np.any(shows_bits(np.full_like(image, 80), truth, expected))
