"""Claims of the report's section on residuals: what it says, and that its figure is right and legible."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from station.fit.image_checks import Residuals, checked_residuals
from station.fit.result import Fit
from station.fit_files import RESIDUALS_FILE, read_fit_residuals, write_fit
from station.logs import JointLog
from station.report import Material
from station.report.blocks import Bullets, Table, Text
from station.report.residual_figure import cell_means, residual_figure
from station.report.sections.residuals import residuals_section
from tests.fit.image_checks.watched_trees import Session, Wrong, watched


@pytest.fixture(scope="module")
def fitted() -> tuple[Fit, Residuals]:
    slip = Wrong(t_s=3.0, marker=1, move=(5e-4, 0, 0, 0, 0, 0))
    tree, image = watched(Session(frames=120, types=("revolute", "revolute")), slip, np.random.default_rng(1))
    t_s = image.views.t_s
    states = JointLog(t_s, tree.columns, np.zeros((len(t_s), 2)), ("rad", "rad"))
    return Fit(tree, states, image), checked_residuals(tree, image)


def test_a_report_tells_what_was_found_in_words_and_by_marker(fitted: tuple[Fit, Residuals]) -> None:
    section = residuals_section(Material("slip", residuals=fitted[1]))
    assert section is not None
    (found,) = (block for block in section.blocks if isinstance(block, Bullets))
    assert found.items[0].startswith("marker 4 on link1 moved at t = ")
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert [row[:2] for row in table.rows] == [["3", "base"], ["4", "link1"], ["5", "link2"]]
    assert float(table.rows[0][4]) == pytest.approx(0.1, rel=0.1)  # px, the noise that it was made with


def test_a_report_says_how_many_tests_found_nothing(fitted: tuple[Fit, Residuals]) -> None:
    residuals = fitted[1]
    clean = replace(residuals, checks=replace(residuals.checks, findings=(), tests=9))
    section = residuals_section(Material("clean", residuals=clean))
    assert section is not None
    assert section.blocks[0] == Text("No test found anything: 9 tests, level 1 in 100.")


def test_a_fit_on_poses_has_no_such_section() -> None:
    assert residuals_section(Material("poses")) is None


def test_means_over_cells_show_a_shift_where_it_is(fitted: tuple[Fit, Residuals]) -> None:
    residuals = fitted[1]
    there = residuals.corners_px[..., 0] > 320
    shifted = replace(residuals, residual_px=residuals.residual_px * 0 + np.where(there, 0.2, 0.0)[..., None] * (1, 0))
    places, means, _ = cell_means(shifted)
    right = places[:, 0] > 320 + 640 / 12
    left = places[:, 0] < 320 - 640 / 12
    np.testing.assert_allclose(means[right], [[0.2, 0.0]] * right.sum())
    np.testing.assert_allclose(means[left], 0.0)


def test_no_text_of_the_figure_overlaps_another_or_leaves_it(fitted: tuple[Fit, Residuals]) -> None:
    residuals = fitted[1]
    long = tuple(f"{name}_of_the_largest_robot" for name in residuals.part)
    figure = residual_figure(replace(residuals, part=long))
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    texts = [text for axes in figure.axes for text in axes.texts if text.get_text()]
    boxes = [text.get_window_extent(renderer) for text in texts]
    for number, (text, box) in enumerate(zip(texts, boxes, strict=True)):
        assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1, text.get_text()
        for other in boxes[:number]:
            assert not box.overlaps(other), text.get_text()


def test_few_or_no_sightings_are_drawn_too(fitted: tuple[Fit, Residuals]) -> None:
    residuals = fitted[1]
    out = replace(residuals, inlier=residuals.inlier * 0)
    for odd in (out, replace(out, residual_px=out.residual_px * np.nan)):
        section = residuals_section(Material("odd", residuals=odd))
        assert section is not None


def test_residuals_stand_beside_a_fit_and_go_with_it(fitted: tuple[Fit, Residuals], tmp_path: Path) -> None:
    fit, residuals = fitted
    write_fit(fit, tmp_path / "fit", residuals=residuals)
    back = read_fit_residuals(tmp_path / "fit")
    assert back is not None
    assert back.checks == residuals.checks
    write_fit(fit, tmp_path / "fit", force=True)
    assert not (tmp_path / "fit" / RESIDUALS_FILE).exists()
    assert read_fit_residuals(tmp_path / "fit") is None
