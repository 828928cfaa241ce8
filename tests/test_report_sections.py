"""Claims of the report's sections: what each tells, of whole sessions and of odd ones, in how many bytes."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.lag import Slope
from station.compare import Comparison
from station.fit.result import Fit
from station.kinematics.tree import Joint, KinematicTree
from station.logs import JointLog
from station.report import (
    Material,
    Redoing,
    Timing,
    Visibility,
    figure7,
    session_lag_text,
    thinning,
    visibility_figure,
    write_report,
)
from station.report.binned import binned
from station.report.blocks import Drawing, Facts, Folded, Section, Source, Table, Text
from station.report.error_figure import ERROR, PREDICTED, ROUNDED, error_figure
from station.report.sections.errors import errors_section
from station.report.sections.events import MOST, events_section
from station.report.sections.fit import fit_section
from station.report.sections.joints import joints_section
from station.report.sections.redoing import redoing_section
from station.report.sections.seen import seen_section
from station.report.sections.servos import servos_section
from station.report.sections.summary import summary_section
from station.report.sections.timing import timing_section
from station.report.sections.tree import tree_section
from station.report.servo_figure import servo_figure
from station.report.space_figure import space_figure
from station.report.timing_figure import timing_figure
from station.report.view_direction import view_axes
from station.session_lag import estimate_session_lag
from tests.made_reports import COUNT_RAD, LAG_S, STD_RAD, Happened, arm_material, events, timing
from tests.test_report import arm, states_of, texts_that_overlap, wide_tree

NAMES = ("base_pan", "shoulder", "elbow_of_the_left_arm_abc", "wrist")


@pytest.fixture(scope="module")
def material() -> Material:
    return arm_material(NAMES)


@pytest.fixture(scope="module", autouse=True)
def _fonts_are_open(material: Material, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """matplotlib keeps its fonts open; and a whole report to look at."""
    folder = tmp_path_factory.mktemp("whole")
    write_report(folder, material)
    return folder


def table(section: Section | None, number: int = 0) -> Table:
    assert section is not None
    return [block for block in section.blocks if isinstance(block, Table)][number]


def column(of: Table, head: str, nth: int = 0) -> list[str]:
    at = [i for i, name in enumerate(of.head) if name == head][nth]
    return [row[at] for row in of.rows]


def facts(section: Section | None) -> dict[str, str]:
    assert section is not None
    return {k: v for block in section.blocks if isinstance(block, Facts) for k, v in block.items.items()}


# --- The lag -------------------------------------------------------------------------------------------------------


def test_the_joints_table_tells_the_error_with_the_lag_applied_and_before(material: Material) -> None:
    comparison = material.comparison
    assert comparison is not None and comparison.lag.applied_s == pytest.approx(LAG_S, abs=0.001)
    section = joints_section(material)
    rows = table(section)
    for row, joint in enumerate(comparison.joints):
        measured = joint.against_measured
        assert measured is not None
        assert column(rows, "RMSE")[row] == f"{np.degrees(measured.rmse):.2f}"
        assert column(rows, "before lag")[row] == f"{np.degrees(measured.rmse_before_lag):.2f}"
        assert float(column(rows, "before lag")[row]) > 2 * float(column(rows, "RMSE")[row])
        assert column(rows, "own lag [ms]")[row].startswith(f"{1e3 * measured.lag_s:.1f}")
    assert section is not None
    said = " ".join(block.text for block in section.blocks if isinstance(block, Text))
    assert f"trails the read-back by {1e3 * comparison.lag.applied_s:.1f} ms" in said and "applied" in said


def test_figure7_says_the_lag_and_each_panels_error_without_it_and_nothing_overlaps(material: Material) -> None:
    assert material.comparison is not None
    figure = figure7(material.comparison, material.viewing)
    said = f"trails the read-back by {1e3 * material.comparison.lag.applied_s:.1f} ms"
    assert any(said in text.get_text() for text in figure.texts)
    titles = [axes.get_title(loc="right") for axes in figure.axes if axes.get_title(loc="left")]
    assert len(titles) == len(NAMES) and all(title.endswith("before lag") for title in titles)
    assert texts_that_overlap(figure) == []


def test_a_lag_that_is_not_applied_is_told_with_the_reason(material: Material) -> None:
    assert material.comparison is not None
    lag = replace(material.comparison.lag, std_s=0.02, why_not="its std is over 5 ms")
    section = joints_section(replace(material, comparison=replace(material.comparison, lag=lag)))
    assert section is not None
    said = " ".join(block.text for block in section.blocks if isinstance(block, Text))
    assert "not applied: its std is over 5 ms" in said


def test_what_is_said_of_the_lag_fits_a_terminal(material: Material) -> None:
    assert material.comparison is not None
    slopes = [[Slope(-0.1234, std_s, 1.0, None)] for std_s in (0.001, 0.02, 0.08)]
    lags = [estimate_session_lag(each) for each in (*slopes, [], [Slope(np.nan, None, np.nan, None)])]
    said = [session_lag_text(replace(material.comparison, lag=lag)) for lag in lags]
    assert len(set(said)) == 5 and max(map(len, said)) <= 100
    assert "leads the read-back by 123 ms" in said[0] and "not applied" in said[1] and "no read-back" in said[3]


# --- Errors --------------------------------------------------------------------------------------------------------


def test_errors_are_gathered_in_the_bins_where_their_angles_are() -> None:
    along = np.array([1.0, 2, 3, 4, 5, 11, 12, 13, 14, 15, 25, np.nan])
    error = np.array([3.0, -3, 3, -3, 3, 4, 4, 4, 4, np.nan, 9, 9])
    found = binned(along, error, 2 * np.ones(12), np.array([0.0, 10, 20, 30]))
    assert found.frames.tolist() == [5, 4, 1]
    np.testing.assert_array_equal(found.error, [3.0, np.nan, np.nan])
    np.testing.assert_array_equal(found.predicted, [2.0, np.nan, np.nan])


def test_the_error_figure_shows_rms_errors_beside_what_is_predicted(material: Material) -> None:
    assert material.comparison is not None
    figure = error_figure(material.comparison, material.viewing, material.readback_steps)
    assert len(figure.axes) == 2 * len(NAMES) and texts_that_overlap(figure) == []
    for axes in figure.axes:
        drawn = {line.get_label(): np.asarray(line.get_ydata(), float) for line in axes.get_lines()}
        expected_deg = np.degrees(np.hypot(STD_RAD, COUNT_RAD / np.sqrt(12)))
        np.testing.assert_allclose(drawn[ROUNDED][np.isfinite(drawn[ROUNDED])], expected_deg)
        np.testing.assert_allclose(drawn[PREDICTED][np.isfinite(drawn[PREDICTED])], np.degrees(STD_RAD))
        # The noise that was made, and the read-back's rounding halved by interpolation at the most.
        error = drawn[ERROR][np.isfinite(drawn[ERROR])]
        assert np.median(error) == pytest.approx(expected_deg, rel=0.15)


def test_errors_without_a_viewing_angle_are_drawn_against_time_alone(material: Material) -> None:
    assert material.comparison is not None
    figure = error_figure(material.comparison, None, {})
    assert [len(axes.get_lines()) for axes in figure.axes[:2]] == [0, 2]
    assert errors_section(replace(material, comparison=Comparison(()))) is None


# --- The tree ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tree", [arm(), wide_tree()], ids=["arm", "wide"])
def test_the_tree_in_space_names_all_bodies_and_nothing_leaves_the_figure(tree: KinematicTree) -> None:
    figure = space_figure(tree, states_of(tree), None)
    assert len(figure.axes) == len(tree.trees)
    assert [pair for pair in texts_that_overlap(figure) if pair[1] == "the edge"] == []


def test_the_tree_in_space_has_each_axis_where_it_is_and_the_camera(material: Material) -> None:
    assert material.fit is not None
    figure = space_figure(material.fit.tree, material.fit.states, material.T_root_camera)
    said = {text.get_text() for text in figure.axes[0].texts if text.get_text()}
    assert {"base_pan", "shoulder", "wrist", "base", "base_pan_link", "camera"} <= said
    assert texts_that_overlap(figure) == []


def test_a_view_shows_axes_from_the_side_and_up_upwards() -> None:
    up = np.array([0.0, 0.0, 1.0])
    for azimuth in np.radians(np.arange(0, 360, 25)):
        axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        view = view_axes(np.array([axis, up]), up, None)
        np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view) == pytest.approx(1.0)
        assert np.linalg.norm(view[:2] @ axis) > 0.99 and view[1] @ up > 0.9


def test_a_view_stays_on_the_cameras_side_also_when_it_looks_straight_down() -> None:
    up = np.array([0.0, 1.0, 0.0])
    towards = np.array([0.3, 0.1, 1.0])
    for seed in range(20):
        viewer = view_axes(np.random.default_rng(seed).normal(size=(3, 3)), up, towards)[2]
        between = np.array([viewer, towards])[:, [0, 2]]
        cosine = between[0] @ between[1] / np.prod(np.linalg.norm(between, axis=1))
        assert cosine > 0.5 - 1e-9, "more than 60 deg to the side of the camera"
    assert np.all(np.isfinite(view_axes(np.eye(3), up, 2 * up)))


def test_balls_and_slides_are_drawn_and_their_numbers_told() -> None:
    ball = Joint("ball", "spherical", "a", "b", None, np.zeros(3), np.eye(4), state_min=0.0, state_max=0.6)
    slide = Joint("slide", "prismatic", "b", "c", np.array([0, 0, 1.0]), None, np.eye(4), state_min=0.0, state_max=0.1)
    screw = Joint("bolt", "screw", "c", "d", np.array([0, 0, 1.0]), np.zeros(3), np.eye(4), pitch_m_per_rad=0.002)
    tree = KinematicTree("a", ("a", "b", "c", "d"), (), (("a", "b", "c", "d"),), (ball, slide, screw))
    q = np.sin(np.linspace(0, 9, 50))[:, None] * np.ones(5)
    q[:10] = np.nan
    units = ("rad", "rad", "rad", "m", "rad")
    fit = Fit(tree, JointLog(np.arange(50.0), tree.columns, q, units, 0.01 * np.ones(q.shape)))
    section = fit_section(Material("s", fit=fit))
    assert column(table(section), "advance [mm/turn]") == ["", "", "12.6"]
    assert column(table(section), "state std")[1] == "10.0, 10.0 mm"
    assert len([block for block in tree_section(Material("s", fit=fit)).blocks if isinstance(block, Drawing)]) == 2


def test_the_fits_numbers_come_with_their_uncertainties(material: Material) -> None:
    section = fit_section(material)
    numbers = table(section)
    assert column(numbers, "± [deg]") == ["0.05"] * 4 and column(numbers, "± [mm]") == ["0.12"] * 4
    assert column(numbers, "state std") == ["0.10, 0.10 deg"] * 4
    assert column(numbers, "axis")[:2] == ["0.0000, 1.0000, 0.0000", "0.0000, 0.0000, 1.0000"]
    assert table(section, 1).head == ("joint", "rigid", "prismatic", "revolute")
    assert table(section, 1).rows[0] == ["base_pan", "< 0.0001", "< 0.0001", "1.0000"]


# --- Timing, servos, visibility ------------------------------------------------------------------------------------


def test_timing_tells_jitter_gaps_and_losses() -> None:
    frame_s = np.arange(100) / 30.0
    frame_s[50:] += 3 / 30.0
    index = np.arange(100) + 3 * (np.arange(100) >= 50)
    request_s = np.arange(0, 3, 0.02)
    request_s = request_s + np.where(np.arange(len(request_s)) % 2, 0.001, -0.001)
    stamps = Timing(frame_s, index, request_s, request_s + 0.004, latency_s=0.016, fps=30.0)
    section = timing_section(Material("s", timing=stamps, counts={"dropped_frames": 3, "live_view": 7}))
    rows = table(section)
    assert column(rows, "gaps") == ["1", "0", "0"] and column(rows, "longest [ms]") == ["133", "22.0", "4.00"]
    assert column(rows, "jitter (std) [ms]") == ["0.00", "2.00", "0.00"]
    told = facts(section)
    assert told["missing in the camera's numbering"] == "3" and told["live view"] == "7"
    assert told["latency taken off the frames' stamps"] == "16.0 ms"
    assert stamps.lost.sum() == 3 and stamps.lost[50] == 3
    figure = timing_figure(stamps)
    assert len(figure.axes) == 3 * 2 + 1 and texts_that_overlap(figure) == []


def test_servos_are_drawn_and_summed_up_also_with_gaps(material: Material) -> None:
    assert material.servos is not None
    rows = table(servos_section(material))
    assert column(rows, "readings")[:3] == ["100", "90", "100"]
    assert column(rows, "hottest [°C]")[0] == f"{material.servos.temperature_c[:, 0].max():.0f}"
    figure = servo_figure(material.servos)
    assert len(figure.axes) == 3 and texts_that_overlap(figure) == []
    silent = replace(material.servos, temperature_c=np.full((100, 9), np.nan))
    assert servos_section(Material("s", servos=silent)) is None


def test_parts_seen_in_long_sessions_take_no_more_room() -> None:
    rng = np.random.default_rng(0)
    t_s = np.arange(0, 3600, 1 / 30)
    seen = rng.random((len(t_s), 2)) > 0.5
    figure = visibility_figure(Visibility(t_s, ("a", "b"), seen, np.where(seen, 30.0, np.nan)))
    for collection in figure.axes[0].collections:
        assert len(collection.get_paths()) <= thinning.COLUMNS


# --- Events, settings ----------------------------------------------------------------------------------------------


def test_few_events_are_in_view_many_are_folded_with_the_grave_ones_above() -> None:
    few = events_section(Material("s", events=events(10.0, 5)))
    assert len(table(few).rows) == 7
    many = events_section(Material("s", events=events(10.0, 60)))
    assert column(table(many), "") == ["warning", "error"]
    assert many is not None and isinstance(many.blocks[-1], Folded) and many.blocks[-1].summary == "all 62 events"
    endless = events_section(Material("s", events=[Happened(float(k), "INFO", "step") for k in range(9000)]))
    assert endless is not None and isinstance(endless.blocks[-1], Folded)
    folded = endless.blocks[-1].blocks[0]
    assert isinstance(folded, Table) and len(folded.rows) == MOST
    assert events_section(Material("s")) is None


def test_settings_stand_as_they_are_in_the_files(material: Material, _fonts_are_open: Path) -> None:
    section = redoing_section(material)
    assert section is not None
    assert [block.summary for block in section.blocks if isinstance(block, Folded)] == ["rig.toml", "motion.toml"]
    assert "station fit . --force" in next(b.text for b in section.blocks if isinstance(b, Source))
    page = (_fonts_are_open / "report.html").read_text("utf-8")
    assert "schema = &#34;rig/1&#34;\n\n# a long line" in page
    assert redoing_section(Material("s", redoing=Redoing())) is None


# --- Odd sessions --------------------------------------------------------------------------------------------------


def test_a_whole_report_is_small(_fonts_are_open: Path) -> None:
    assert (_fonts_are_open / "report.html").stat().st_size < 3_000_000


def test_an_hour_makes_a_report_no_heavier_than_minutes(tmp_path: Path) -> None:
    write_report(tmp_path, arm_material(("pan",), 3600.0, gaps=0.1))
    assert (tmp_path / "report.html").stat().st_size < 1_500_000


def test_a_thinned_line_keeps_its_extremes_its_gaps_and_breaks_at_pauses() -> None:
    t_s = np.arange(0, 3600, 1 / 30)
    t_s = t_s[(t_s < 1000) | (t_s > 1200)]
    values = np.sin(t_s / 100) + 0.1 * np.random.default_rng(0).normal(size=len(t_s))
    values[40_000], values[(t_s > 2000) & (t_s < 2100)] = 9.0, np.nan
    values[::7] = np.nan
    thin_s, thin = thinning.line(t_s, values)
    assert len(thin) < 5 * thinning.COLUMNS and np.nanmax(thin) == 9.0 and np.nanmin(thin) == np.nanmin(values)
    unknown = thin_s[np.isnan(thin)]
    assert np.all(((unknown > 1990) & (unknown < 2110)) | (np.abs(unknown - 1000) < 1))
    assert np.any(np.abs(unknown - 1000) < 1), "a line would cross the pause"
    edges_s, low, high = thinning.band(t_s, values - 1, values + 1)
    assert (
        len(edges_s) <= 2 * thinning.COLUMNS + 2 and np.nanmax(high) == 10.0 and np.nanmin(low) == np.nanmin(values) - 1
    )


@pytest.mark.parametrize(
    "odd",
    [
        Material("nothing"),
        Material("bare", fit=Fit(arm(), states_of(arm()))),
        Material("still", timing=Timing(np.zeros(0), np.zeros(0, int), np.zeros(0), np.zeros(0))),
        Material("one_frame", timing=Timing(np.ones(1), np.ones(1, int), np.ones(1), np.ones(1) + 0.01)),
        Material(
            "blind", visibility=Visibility(np.arange(5.0), ("a",), np.zeros((5, 1), bool), np.full((5, 1), np.nan))
        ),
        Material("empty", visibility=Visibility(np.zeros(0), ("a",), np.zeros((0, 1), bool), np.zeros((0, 1)))),
        Material("unknown", fit=Fit(arm(), replace(states_of(arm()), q=np.full((60, 4), np.nan), std=None))),
        Material("hand", timing=timing(90), comparison=Comparison((), at_rest=("gripper",))),
    ],
    ids=lambda material: material.title,
)
def test_odd_sessions_have_a_report_too(odd: Material, tmp_path: Path) -> None:
    write_report(tmp_path, odd)
    page = (tmp_path / "report.html").read_text("utf-8")
    assert f"<h1>{odd.title}</h1>" in page and "nan" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL).lower()


def test_no_marker_at_all_is_said_in_words() -> None:
    blind = Visibility(np.arange(5.0), ("a",), np.zeros((5, 1), bool), np.full((5, 1), np.nan))
    section = seen_section(Material("s", visibility=blind))
    assert section is not None and isinstance(section.blocks[0], Text) and "No part was seen" in section.blocks[0].text
    (said,) = [block.text for block in tree_section(Material("s")).blocks if isinstance(block, Text)]
    assert "Nothing was fitted" in said
    assert "no warnings" in str(summary_section(Material("s")).blocks)
