"""The picture of a plan: whatever is drawn, no label lies over another."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from station.foresight.forecast import foresee, frame_times_s
from station.foresight.joints import joint_outlooks
from station.foresight.scene import Mount, Scene
from station.motion import Plan
from station.report.drawings import png
from station.report.plan_figure import plan_figure
from tests.foresight.scenes import FACING, at, mount, plan, scene


def figure_of(made: Scene, planned: Plan, frames: int = 3) -> Figure:
    forecast = foresee(planned, made, frame_times_s(planned.duration_s, 30.0))
    picture = np.full((48, 64, 3), 128, np.uint8)
    views = dict.fromkeys(range(0, frames * 2, 2), picture)
    return plan_figure(forecast, joint_outlooks(forecast), views)


def overlapping(figure: Figure) -> list[tuple[str, str]]:
    """Pairs of texts that lie over each other; numbers of markers in the pictures lie where the markers are."""
    figure.draw_without_rendering()
    boxes = {
        text: text.get_window_extent()
        for text in figure.findobj(Text)
        if isinstance(text, Text) and text.get_visible() and text.get_text() and text.get_bbox_patch() is None
    }
    return [
        (a.get_text(), b.get_text()) for a, b in combinations(boxes, 2) if boxes[a].shrunk(0.9, 0.7).overlaps(boxes[b])
    ]


def many(count: int, name: str) -> list[Mount]:
    places = [(x, y) for y in np.linspace(-0.18, 0.18, 4) for x in np.linspace(-0.25, 0.25, -(-count // 4))]
    mounts = [mount(k, "arm" if k % 2 else "base", at(x, y, 0) @ FACING) for k, (x, y) in enumerate(places[:count])]
    return [Mount(m.marker_id, f"{name}_{m.marker_id}", m.body, m.T_body_marker, 0.03, 0.005, 6) for m in mounts]


@pytest.mark.parametrize(("count", "name"), [(1, "a"), (20, "a_very_long_name_of_a_part_that_somebody_chose")])
def test_no_label_lies_over_another(count: int, name: str):
    assert overlapping(figure_of(scene(mounts=many(count, name)), plan(*([0.4, -0.4] * 3)))) == []


def test_a_slide_and_steps_that_follow_quickly_are_drawn_too():
    quick = plan(*([0.01, -0.01] * 60), speed=0.5, unit="m", hold_s=0.01)
    figure = figure_of(scene("prismatic", mounts=many(6, "part")), quick)
    assert overlapping(figure) == []
    assert png(figure).startswith(b"\x89PNG")


def test_a_motion_in_which_nothing_moves_has_no_bars_of_joints():
    figure = figure_of(scene(mounts=many(2, "part")), plan(0.0))
    assert "joint" not in {text.get_text() for text in figure.findobj(Text) if isinstance(text, Text)}
