"""The viewer's layout for a session."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import rerun as rr
import rerun.blueprint as rrb

from station.recording.layout import (
    AXES,
    CAMERA_FRAME,
    COMMANDED,
    DETECTED,
    ELAPSED,
    EVENTS,
    IMAGE,
    LIVE_IMAGE,
    LIVE_STATES,
    MARKERS,
    MEASURED,
    SERVOS,
    TRANSFORMS,
)

if TYPE_CHECKING:
    from rerun.encodings import EntityPathLike

JOINT_STATES = (COMMANDED, MEASURED, LIVE_STATES, DETECTED)


def session_blueprint(joints: Sequence[str]) -> rrb.Blueprint:
    """The viewer's layout: camera and markers in space, the image with the detected corners, the joints, the log."""
    space = rrb.Spatial3DView(
        name="space",
        contents=[
            f"/{IMAGE}",
            f"/{LIVE_IMAGE}",
            f"/{TRANSFORMS}",
            f"/{MARKERS}/**",
            f"/{AXES}/**",
        ],
        spatial_information=rrb.SpatialInformation(target_frame=CAMERA_FRAME),
        # From above and to the right of the camera, whose y points down.
        eye_controls=rrb.EyeControls3D(position=(0.36, -0.31, -0.16), look_target=(0, 0, 0.4), eye_up=(0, -1, 0)),
        line_grid=False,
    )
    image = rrb.Spatial2DView(name="camera", origin=f"/{IMAGE}", contents="$origin/**")
    log = rrb.TextLogView(name="log", origin=f"/{EVENTS}")
    seen = rrb.Horizontal(space, image)
    # Without commanded joints too: a fit's states come into the same view.
    below = rrb.Horizontal(_joint_views(joints), log, column_shares=[5, 2])
    time_panel = rrb.TimePanel(timeline=ELAPSED, state="collapsed")
    return rrb.Blueprint(rrb.Vertical(seen, below), time_panel, collapse_panels=True)


def _joint_views(joints: Sequence[str]) -> rrb.Tabs:
    """All joints together, then each alone, if they are known."""
    return rrb.Tabs(
        rrb.TimeSeriesView(name="joints", origin="/", contents=[f"/{entity}" for entity in JOINT_STATES]),
        # One more than there are joints stands for all that a fit names otherwise.
        *[_joint_view(joint, [other == joint for other in (*joints, "")]) for joint in joints],
        *([rrb.TimeSeriesView(name="servos", origin=f"/{SERVOS}")] if joints else []),
    )


def _joint_view(joint: str, shown: Sequence[bool]) -> rrb.TimeSeriesView:
    paths = [f"/{entity}" for entity in JOINT_STATES]
    series: dict[EntityPathLike, rr.SeriesLines] = dict.fromkeys(
        paths, rr.SeriesLines.from_fields(visible_series=shown)
    )
    return rrb.TimeSeriesView(name=joint, origin="/", contents=paths, overrides=series)
