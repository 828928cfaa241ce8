"""Forecasts of small motions: what is seen, why not, which joints are told, and what the warnings say."""

from __future__ import annotations

import re

import numpy as np
import pytest

from station.foresight.detector import OBLIQUE, OUTSIDE, SEEN, SMEARED, TURNED_AWAY
from station.foresight.forecast import MOST_FRAMES, Forecast, foresee, frame_times_s
from station.foresight.joints import joint_outlooks
from station.foresight.remarks import forecast_remarks
from station.foresight.scene import Scene
from station.motion import Plan
from tests.foresight.scenes import FACING, SIZE_M, at, mount, plan, scene


def forecast_of(made: Scene, planned: Plan, fps: float = 60.0) -> Forecast:
    return foresee(planned, made, frame_times_s(planned.duration_s, fps))


def remarks_of(made: Scene, planned: Plan) -> tuple[str, ...]:
    forecast = forecast_of(made, planned)
    return forecast_remarks(forecast, joint_outlooks(forecast))


def test_a_marker_that_turns_is_seen_then_too_oblique_then_turned_away():
    forecast = forecast_of(
        scene(mounts=[mount(0, "base", at(-0.2, 0, 0) @ FACING), mount(1, "arm", FACING)]), plan(2.0)
    )
    reason = forecast.reason[:, 1]
    order = reason[np.flatnonzero(np.diff(reason, prepend=-1))].tolist()
    assert order == [SEEN, OBLIQUE, TURNED_AWAY]
    # 50 px of square: 1.57 px a cell are left at 79 deg of turn; the marker is near the axis of the camera.
    last = np.degrees(forecast.sight.tilt_rad[np.flatnonzero(reason == SEEN)[-1], 1])
    assert last == pytest.approx(79, abs=2)


def test_a_marker_that_slides_out_of_the_image_is_out_of_it_to_its_last_corner():
    forecast = forecast_of(scene("prismatic", mounts=[mount(1, "arm", FACING)]), plan(0.5, speed=0.2, unit="m"))
    low = forecast.sight.corners_px[..., 1].max(axis=-1)[:, 0]
    assert (forecast.reason[:, 0] == np.where(low > 476.5, OUTSIDE, SEEN)).all()


def test_a_fast_slide_smears_and_the_speed_that_is_proposed_would_do():
    made, quick = scene("prismatic", exposure_s=0.02), plan(0.1, speed=0.6, unit="m", mode="stream")
    forecast = forecast_of(made, quick)
    assert (forecast.reason[:, 1] == SMEARED).any()
    little, warning = remarks_of(made, quick)
    assert "smeared: go slower" in little
    proposed = re.search(r"joint at (\d+\.\d) mm/s instead of 600\.0 mm/s", warning)
    assert proposed, warning
    slower = float(proposed[1]) / 1e3
    assert remarks_of(made, plan(0.1, speed=0.98 * slower, unit="m", mode="stream")) == ()
    assert remarks_of(made, plan(0.1, speed=1.05 * slower, unit="m", mode="stream")) != ()


def test_of_a_joint_is_told_how_much_of_its_way_is_seen_and_where():
    made = scene(mounts=[mount(0, "base", at(-0.2, 0, 0) @ FACING), mount(1, "arm", FACING)])
    forecast = forecast_of(made, plan(2.0))
    (joint,) = joint_outlooks(forecast)
    assert joint.visible is not None
    assert joint.visible[1] == pytest.approx(np.radians(79), abs=0.04)
    assert joint.travel_share == pytest.approx(joint.visible[1] / 2.0, abs=0.02)
    assert joint.oblique_share == pytest.approx((joint.visible[1] - np.pi / 3) / joint.visible[1], abs=0.03)
    (warning,) = remarks_of(made, plan(2.0))
    assert "of its motion (0.0 deg to 11" in warning and "turned away" in warning and "arm" in warning


def test_a_joint_seen_from_the_side_alone_is_warned_of():
    steep = mount(1, "arm", at(0, 0, 0) @ FACING @ turned_about_x(np.radians(70)))
    made = scene("prismatic", mounts=[mount(0, "base", at(-0.2, 0, 0) @ FACING), steep])
    assert any("over 60 deg off the line of sight" in remark for remark in remarks_of(made, plan(0.02, unit="m")))


def turned_about_x(angle: float) -> np.ndarray:
    T = np.eye(4)
    T[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return T


def test_a_body_without_a_marker_is_named():
    (warning,) = remarks_of(scene(mounts=[mount(1, "arm", FACING)]), plan(0.3))
    assert "joint" in warning and "no marker on base" in warning


def test_a_joint_that_rests_is_not_warned_of():
    assert remarks_of(scene(mounts=[mount(1, "arm", FACING)]), plan(0.0)) == ()


def test_small_and_large_markers_are_lost_at_the_same_pixels_a_cell():
    far, near = (
        scene(mounts=[mount(1, "arm", at(0, 0, away - 0.6) @ FACING)])
        for away in (600 * SIZE_M / 9.0, 600 * SIZE_M / 10.0)
    )
    assert forecast_of(far, plan(0.0)).why(0, 0) == "too small"
    assert forecast_of(near, plan(0.0)).why(0, 0) == "seen"


def test_long_motions_are_looked_at_less_often_and_to_their_end():
    t_s = frame_times_s(7200.0, 30.0)
    assert len(t_s) == MOST_FRAMES
    assert t_s[0] > 0 and t_s[-1] == pytest.approx(7200.0, abs=0.5)
    assert frame_times_s(10.0, 30.0) == pytest.approx((np.arange(300) + 0.5) / 30)
