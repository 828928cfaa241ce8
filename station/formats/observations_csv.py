"""observations.csv: what the camera saw of each marker: its corners in the image, and how well the pose fits them."""

from __future__ import annotations

import csv
import io

import numpy as np

from station.perception.observations import CORNERS, ObservationLog

CORNER_COLUMNS = tuple(f"{axis}{corner}_px" for corner in range(1, CORNERS + 1) for axis in "uv")
COLUMNS = ("t_s", "frame", "marker", *CORNER_COLUMNS, "rms_px")


def format_observations_csv(log: ObservationLog) -> str:
    """Text with a row a marker of a frame, `frame` counting the log's; corners clockwise from the top left.

    Numbers read back to the same float64. Poses and covariances are left out: Parquet has them.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    numbers = np.column_stack([log.corners_px.reshape(-1, 2 * CORNERS), log.rms_px[:, 0]]).tolist()
    stamps = log.t_s[log.frame].tolist()
    for t_s, frame, marker, row in zip(stamps, log.frame.tolist(), log.marker_id.tolist(), numbers, strict=True):
        writer.writerow([repr(t_s), frame, marker, *("" if x != x else repr(x) for x in row)])
    return out.getvalue()
