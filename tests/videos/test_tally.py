"""What is counted of markers in a video, and what their sizes say of each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.kinematics import se3
from station.perception.dictionary_search import find_dictionary
from station.perception.markers import Marker, MarkerTable
from station.perception.observations import FrameMarkers
from station.videos.sizes import size_factors
from station.videos.tally import MarkerTally
from tests.videos.made_videos import cabinet, images, tilt

TABLE = MarkerTable("DICT_4X4_50", (Marker(3, "lid", 0.05), Marker(5, "box", 0.05)))
SHARP = np.full((1, 4), 2.0)


def seen(*ids: int, tilt_deg: float = 30.0, rms_px: float = 0.1) -> FrameMarkers:
    count = len(ids)
    T = se3.pose(tilt(tilt_deg, 0.0), np.array([0, 0, 0.5]))
    return FrameMarkers(
        marker_id=np.array(ids, dtype=np.int64),
        corners_px=np.zeros((count, 4, 2)),
        corner_covariance_px2=np.full((count, 4, 2, 2), np.nan),
        T_cam_marker=np.tile(T, (count, 2, 1, 1)),
        rms_px=np.full((count, 2), rms_px),
    )


def test_gaps_count_frames_and_the_time_between_sightings() -> None:
    tally = MarkerTally(TABLE)
    for k, ids in enumerate([(), (3,), (), (), (), (3,), (3,), ()]):
        tally.add(0.5 * k, seen(*ids), [], SHARP[: len(ids)])
    lid, box = tally.rows()
    assert (lid.seen, lid.frames, lid.gap_frames, lid.gap_s) == (3, 8, 3, pytest.approx(2.0))
    assert (lid.tilt_deg, lid.rms_px) == (pytest.approx(30, abs=0.01), pytest.approx(0.1))
    assert (box.seen, box.gap_frames, box.gap_s, box.tilt_deg, box.rms_px) == (0, 8, pytest.approx(3.5), None, None)
    assert list(tally.warnings()) == ["marker 5 (box) was never seen"]


@given(st.lists(st.booleans(), min_size=1, max_size=40))
def test_seen_and_longest_gap_are_those_of_a_plain_count(sightings: list[bool]) -> None:
    tally = MarkerTally(TABLE)
    for k, there in enumerate(sightings):
        tally.add(float(k), seen(*([3] if there else [])), [], SHARP)
    row = tally.rows()[0]
    gaps = "".join("x" if there else "." for there in sightings).split("x")
    assert (row.seen, row.gap_frames) == (sum(sightings), max(map(len, gaps)))


def test_a_pattern_seen_once_is_chance_and_one_seen_often_is_told() -> None:
    tally = MarkerTally(TABLE)
    for k in range(100):
        tally.add(float(k), seen(3, 5), [7] * (k % 10 == 0) + [9] * (k == 50), SHARP)
    assert list(tally.warnings()) == ["markers were seen that are not in the table: 7 (10 frames)"]


def test_blur_is_told_from_two_in_a_hundred_frames_on() -> None:
    for blurred, told in ((2, False), (3, True)):
        tally = MarkerTally(TABLE)
        for k in range(100):
            tally.add(float(k), seen(3, 5), [], 3 * SHARP if k < blurred else SHARP)
        assert any("3 of 100 frames with markers are blurred" in warning for warning in tally.warnings()) == told


@given(
    st.floats(0.5, 2.0),
    st.floats(0.5, 2.0),
    st.floats(-40, 40),
    st.floats(-40, 40),
    st.integers(0, 10**6),
)
def test_true_sizes_come_out_of_exact_poses(k_i: float, k_j: float, x_deg: float, y_deg: float, seed: int) -> None:
    """Markers k times as large as the table says look 1/k as far; the part's mounts tell."""
    rng = np.random.default_rng(seed)
    mounts = [se3.exp(np.concatenate([rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.5, 0.5, 3)])) for _ in range(2)]
    mounts[1][:3, 3] += (0.15, 0, 0)
    i, j = (Marker(n, "part", 0.05, mount) for n, mount in enumerate(mounts))
    T_cam_part = se3.pose(tilt(x_deg, y_deg), np.array([0.05, -0.1, 0.8]))
    looks = [T_cam_part @ mount for mount in mounts]
    for T, k in zip(looks, (k_i, k_j), strict=True):
        T[:3, 3] /= k
    factors = size_factors(i, looks[0], j, looks[1])
    assert factors is not None
    np.testing.assert_allclose(factors, [k_i, k_j], rtol=1e-6)


def test_markers_that_show_different_rotations_say_nothing_of_sizes() -> None:
    i, j = Marker(0, "part", 0.05), Marker(1, "part", 0.05, se3.translation([0.1, 0, 0]))
    T = se3.pose(tilt(20, 0), np.array([0, 0, 0.6]))
    flipped = se3.pose(tilt(-20, 0), np.array([0.1, 0, 0.6]))
    assert size_factors(i, T, j, T @ j.mount) is not None
    assert size_factors(i, T, j, flipped) is None


@pytest.mark.parametrize("dictionary", ["DICT_4X4_50", "DICT_5X5_250", "DICT_6X6_50", "DICT_APRILTAG_36h11"])
def test_the_dictionary_of_markers_is_found(dictionary: str) -> None:
    shown = images(cabinet(), 3, dictionary=dictionary)
    found = find_dictionary(shown)
    assert found is not None and found.ids == (0, 1, 2) and found.images == 3 and not found.mirrored
    assert found.name.rsplit("_", 1)[0] == dictionary.rsplit("_", 1)[0]  # the smallest of those that share them
    mirrored = find_dictionary([image[:, ::-1] for image in shown])
    assert mirrored is not None and mirrored.mirrored and mirrored.name == found.name


def test_no_dictionary_is_found_where_there_are_no_markers() -> None:
    noise = np.random.default_rng(1).integers(0, 255, (3, 240, 320, 3), dtype=np.uint8)
    assert find_dictionary([*noise]) is None and find_dictionary([]) is None
