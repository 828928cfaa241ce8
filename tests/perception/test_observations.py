import numpy as np
import pytest

from station.errors import InvalidData
from station.perception.observations import FrameMarkers, ObservationBuilder, ObservationLog


def values(count: int) -> dict[str, np.ndarray]:
    return {
        "corners_px": np.zeros((count, 4, 2)),
        "corner_covariance_px2": np.zeros((count, 4, 2, 2)),
        "T_cam_marker": np.full((count, 2, 4, 4), np.nan),
        "rms_px": np.zeros((count, 2)),
    }


def markers(ids: list[int]) -> FrameMarkers:
    return FrameMarkers(np.array(ids, dtype=np.int64), **values(len(ids)))


def test_frames_without_markers_keep_their_times() -> None:
    builder = ObservationBuilder()
    for t_s, ids in ((0.0, []), (0.1, [3, 1]), (0.2, []), (0.3, [3])):
        builder.add(t_s, markers(ids))
    log = builder.build()
    assert log.t_s.tolist() == [0.0, 0.1, 0.2, 0.3]
    assert (log.frame.tolist(), log.marker_id.tolist()) == ([1, 1, 3], [3, 1, 3])


def test_a_log_of_nothing_is_a_log() -> None:
    assert len(ObservationBuilder().build()) == 0


def test_a_log_keeps_what_it_was_given() -> None:
    corners = values(1)["corners_px"]
    log = ObservationLog(t_s=np.array([0.0]), frame=np.array([0]), marker_id=np.array([2]), **values(1))
    corners[:] = 7.0
    assert not np.any(log.corners_px)
    with pytest.raises(ValueError, match="read-only"):
        log.marker_id[0] = 1


@pytest.mark.parametrize(
    ("t_s", "frame", "marker_id", "message"),
    [
        ([0.0, 0.0], [0, 1], [1, 1], "times must increase"),
        ([0.0, 0.1], [1, 0], [1, 1], "frames must not fall"),
        ([0.0, 0.1], [0, 2], [1, 1], "lie within 0 to 1"),
        ([0.0, 0.1], [0, 0], [1, 1], "a marker appears twice in one frame"),
        ([0.0, 0.1], [0, 1], [1], "marker_id has shape"),
    ],
)
def test_what_is_no_log_is_refused(t_s: list, frame: list, marker_id: list, message: str) -> None:
    with pytest.raises(InvalidData, match=message):
        ObservationLog(t_s=np.array(t_s), frame=np.array(frame), marker_id=np.array(marker_id), **values(len(frame)))
