"""Figures of a sweep: what they show of its rows and stored fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from station.errors import InvalidData
from station.experiments import Cell, Grid, JointRow, NamedTree, NoiseLevel, Row, Sweep, simulated
from station.experiments.bounds import cell_bounds, median_error
from station.formats.trees import load_tree
from station.kinematics.tree import KinematicTree
from station.kinematics.tree_json import to_json
from station.report.axis_error_figure import axis_error_figure, axis_errors, axis_types
from station.report.figure5 import drawn_joint, figure5, three_levels, write_figure5
from station.report.joint_attempts import attempt_of, attempt_text, best_row
from station.report.structure_figure import structure_figure
from station.report.sweep_levels import conditions
from station.report.types_figure import confusion, type_names, types_figure
from station.simulate import GaussianNoise, SimulationOptions, UniformNoise

LEVELS = (NoiseLevel(0.0005, 0.02), NoiseLevel(0.0025, 0.1), NoiseLevel(0.01, 0.4))
TREE = load_tree("experiment1")


class MadeSweep(Sweep):
    """A sweep whose fits found the trees that they are told."""

    found: dict[tuple[object, ...], KinematicTree]

    def found_tree(self, cell: Cell) -> KinematicTree | None:
        return TREE.rerooted("left")


def grid(**changes: object) -> Grid:
    options = SimulationOptions(frames=30)
    values: dict[str, object] = {"trees": (NamedTree("experiment1", TREE),), "noise": LEVELS, "inflation": (0, 1)}
    return Grid(**(values | {"repeats": 2, "options": options} | changes))  # type: ignore[arg-type]


def row(cell: Cell, found: Sequence[str | None] = ("prismatic", "revolute", "revolute"), error_deg: float = 1.0) -> Row:
    """What a fit that took the joints for these types would be told as."""
    joints = tuple(
        JointRow(
            joint=joint.name,
            true_type=joint.type,
            found_type=kind,
            found_joint=None if kind in (None, "rigid") else joint.name,
            axis_error_deg=error_deg if kind == joint.type else None,
            point_error_mm=None,
            state_rms=None,
        )
        for joint, kind in zip(TREE.joints, found, strict=True)
    )
    right = all(joint.found_joint is not None for joint in joints)
    types = right and all(joint.found_type == joint.true_type for joint in joints)
    return Row(cell, right, right, types, error_deg, None, joints, 0.1, None, "none")


def failed(cell: Cell) -> Row:
    return Row(cell, False, False, False, None, None, (), 0.1, "no tree", "none")


def made_sweep(folder: Path, rows: Sequence[Row] | None = None, **changes: object) -> Sweep:
    made = grid(**changes)
    return MadeSweep(folder, made, tuple(row(cell) for cell in made.cells()) if rows is None else tuple(rows))


def texts(figure: Figure) -> list[tuple[str, np.ndarray]]:
    """All that is written in a figure, with its place [px]."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    hidden = {label for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for label in _hidden_labels(axis)}
    found = [text for text in figure.findobj(Text) if isinstance(text, Text) and text.get_text() and text.get_visible()]
    return [
        (text.get_text(), text.get_window_extent(canvas.get_renderer()).extents) for text in found if text not in hidden
    ]


def _hidden_labels(axis: Axis) -> list[Text]:
    """Of ticks that there are beyond the axis' ends, or that have no labels."""
    low, high = sorted(axis.get_view_interval())
    ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
    return [label for tick in ticks for label in (tick.label1, tick.label2) if not low <= tick.get_loc() <= high]


def drawn_over(figure: Figure) -> list[tuple[str, str]]:
    """Pairs of texts that cover each other."""
    return [
        (a, b)
        for (a, box_a), (b, box_b) in combinations(texts(figure), 2)
        if np.all(np.minimum(box_a[2:], box_b[2:]) - np.maximum(box_a[:2], box_b[:2]) > 1)
    ]


def test_all_figures_are_written_as_png_and_svg(tmp_path: Path) -> None:
    sweep = made_sweep(tmp_path)
    written = write_figure5(sweep, tmp_path / "new" / "figures")
    assert [path.name for path in written] == [
        f"{name}.{ending}" for name in ("figure5", "structure", "types", "axes") for ending in ("png", "svg")
    ]
    for path in written:
        if path.suffix == ".png":
            with Image.open(path) as image:
                assert image.size[0] == 1500  # 10 inches
        else:
            assert path.read_text().startswith("<?xml")


@pytest.mark.parametrize("draw", [figure5, structure_figure, types_figure, axis_error_figure])
def test_no_text_of_a_figure_covers_another_or_leaves_it(tmp_path: Path, draw: object) -> None:
    worst = made_sweep(tmp_path)
    rows = [row(each.cell, ("rigid", None, "prismatic")) for each in worst.rows]
    for sweep in (worst, replace(worst, rows=tuple(rows))):
        figure = draw(sweep)  # type: ignore[operator]
        assert drawn_over(figure) == []
        width, height = figure.get_size_inches() * figure.dpi
        for text, (left, bottom, right, top) in texts(figure):
            assert left >= 0 and bottom >= 0 and right <= width and top <= height, text


def test_figure_5_tells_types_and_errors_at_low_middle_and_high_noise(tmp_path: Path) -> None:
    rows = [
        row(cell, ("revolute",) * 3 if cell.noise == LEVELS[2] and cell.method == "paper" else
            ("prismatic", "revolute", "revolute"), error_deg=0.5 + cell.repeat)
        for cell in grid().cells()
    ]  # fmt: skip
    told = "\n".join(text for text, _ in texts(figure5(made_sweep(tmp_path, rows))))
    assert "low noise: 0.5 mm, 1.1°" in told and "high noise: 10 mm, 23°" in told
    assert told.count("prismatic, axis 0.5° off; prismatic in 2 of 2 repeats") == 5
    assert "revolute; prismatic in 0 of 2 repeats\nall joints: revolute, revolute, revolute" in told
    assert "method paper" in told and "method station" in told


def test_the_best_attempt_has_the_type_then_the_least_error_then_the_structure() -> None:
    cells = [cell for cell in grid(repeats=5, methods=("paper",), noise=LEVELS[:1], inflation=(0,)).cells()]
    rows = [
        row(cells[0], (None, "revolute", "revolute")),
        row(cells[1], ("revolute", "revolute", "revolute")),
        row(cells[2], ("prismatic", "revolute", "revolute"), error_deg=4.0),
        row(cells[3], ("prismatic", "revolute", "revolute"), error_deg=2.0),
        failed(cells[4]),
    ]
    assert best_row(rows, "slide") is rows[3]
    assert best_row(rows[:2], "slide") is rows[1]
    assert best_row(rows[:1], "slide") is rows[0]
    assert best_row(rows[4:], "slide") is None


def test_an_attempt_is_told_from_the_true_parent_though_the_fit_has_it_the_other_way_round(tmp_path: Path) -> None:
    sweep = made_sweep(tmp_path)
    first = sweep.rows[0]
    attempt = attempt_of(sweep, first, "slide")
    made = simulated(first.cell, TREE)
    assert attempt.joint is not None and (attempt.joint.parent, attempt.joint.child) == ("middle", "left")
    # The made fit is the true tree told from its child: at the true states it goes where the child truly was.
    way = attempt.joint.forward(made.states.state("slide"))
    np.testing.assert_allclose(way, attempt.true, atol=1e-9)
    off_m = np.abs(attempt.measured[:, :3, 3] - attempt.true[:, :3, 3])
    assert 0 < off_m.max() < 0.05  # 0.02 rad of noise of the parent, 0.45 m away, and 0.5 mm
    assert attempt_text(attempt) == "prismatic, axis 1° off"


@pytest.mark.parametrize(
    ("found", "text"), [(None, "no joint between its bodies"), ("rigid", "rigid, one body of both"), ("revolute",) * 2]
)
def test_an_attempt_of_another_type_says_so(tmp_path: Path, found: str | None, text: str) -> None:
    sweep = made_sweep(tmp_path)
    attempt = attempt_of(sweep, row(sweep.rows[0].cell, (found, "revolute", "revolute")), "slide")
    assert attempt_text(attempt) == text
    assert (attempt.joint is None) == (found in (None, "rigid"))


def test_a_fit_that_was_not_kept_is_made_again(tmp_path: Path) -> None:
    sweep = Sweep(tmp_path, *_grid_and_rows())
    attempt = attempt_of(sweep, sweep.rows[0], "slide")
    assert attempt.joint is not None and attempt.joint.type == "prismatic"


def _grid_and_rows() -> tuple[Grid, tuple[Row, ...]]:
    """A fit of the station's at the least noise, whose joint has the name that it gives it."""
    made = grid(methods=("station",), repeats=1, inflation=(0,), options=SimulationOptions(frames=60))
    told = row(made.cells()[0])
    slide = replace(told.joints[0], found_joint="middle__left")
    return made, (replace(told, joints=(slide, *told.joints[1:])),)


def test_a_failed_fit_and_one_that_is_still_to_come_are_told_apart(tmp_path: Path) -> None:
    cells = grid(methods=("paper",)).cells()
    rows = [failed(cell) if cell.noise == LEVELS[0] else row(cell) for cell in cells if cell.noise != LEVELS[2]]
    told = [text for text, _ in texts(figure5(made_sweep(tmp_path, rows, methods=("paper",))))]
    assert "no fit succeeded" in told and "not fitted yet" in told


def test_what_all_fits_share_is_told(tmp_path: Path) -> None:
    plain, others = SimulationOptions(frames=30), SimulationOptions(frames=30, known_noise=True, missing=0.1)
    assert conditions(made_sweep(tmp_path, [], options=plain)) == (
        "experiment1; 30 frames, walk, moving root, uniform noise"
    )
    told = conditions(made_sweep(tmp_path, [], options=others))
    assert told.endswith("uniform noise, known to the fit, 10 % not seen")


def test_a_sweep_without_rows_has_no_figure_5(tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match="no rows yet"):
        figure5(made_sweep(tmp_path, []))


def test_figure_5_is_of_the_first_tree_that_slides(tmp_path: Path) -> None:
    lamp, chair = NamedTree("lamp", load_tree("lamp")), NamedTree("swivel_chair", load_tree("swivel_chair"))
    sliding = [named for named in (lamp, chair) if any(j.type == "prismatic" for j in named.tree.joints)]
    name, _, joint = drawn_joint(made_sweep(tmp_path, [], trees=(lamp, chair)))
    assert (name, joint.type) == ((sliding[0].name, "prismatic") if sliding else ("lamp", "revolute"))


def test_the_three_levels_are_the_ends_and_the_middle() -> None:
    four = [NoiseLevel(0.001 * i, 0.01 * i) for i in range(4)]
    assert three_levels(four) == [("low noise", four[0]), ("middle noise", four[2]), ("high noise", four[3])]
    assert three_levels(four[:2]) == [("low noise", four[0]), ("high noise", four[1])]
    assert three_levels(four[:1]) == [("low noise", four[0])]


def test_confusion_counts_every_joint_once_and_failed_fits_as_none(tmp_path: Path) -> None:
    cells = [cell for cell in grid().cells() if cell.method == "paper" and cell.noise == LEVELS[0]]
    found = [row(cells[0]), row(cells[1], ("rigid", None, "revolute")), failed(cells[2])]
    sweep = made_sweep(tmp_path, found)
    assert type_names(sweep) == (["prismatic", "revolute"], ["prismatic", "revolute", "rigid", "none"])
    assert confusion(sweep, "paper", LEVELS[0]).tolist() == [[1, 0, 1, 1], [0, 3, 0, 3]]
    assert confusion(sweep, "station", LEVELS[0]).sum() == 0


def test_axis_errors_are_those_of_joints_with_their_type(tmp_path: Path) -> None:
    cells = [cell for cell in grid().cells() if cell.method == "paper" and cell.noise == LEVELS[0]]
    without = [cell for cell in cells if cell.options.inflation == 0]
    rows = [row(without[0], error_deg=0.25), row(without[1], ("revolute", "revolute", "prismatic"), error_deg=3.0)]
    sweep = made_sweep(tmp_path, rows)
    assert axis_types(sweep) == ["prismatic", "revolute"]
    assert axis_errors(sweep, "paper", "prismatic", LEVELS[0], 0).tolist() == [0.25]
    assert axis_errors(sweep, "paper", "revolute", LEVELS[0], 0).tolist() == [0.25, 0.25, 3.0]
    assert axis_errors(sweep, "paper", "revolute", LEVELS[0], 1).size == 0


def test_the_median_of_errors_is_that_of_a_gaussian() -> None:
    # Of a vector with two components of deviation s it is s sqrt(2 ln 2); 501 draws are good to 5 %.
    assert median_error([np.diag([0.04, 0.04])]) == pytest.approx(0.2 * np.sqrt(2 * np.log(2)), rel=0.1)
    assert median_error([np.diag([1.0, 0.0])]) == pytest.approx(0.6745, rel=0.1)
    assert median_error([np.eye(2), *[np.diag([np.inf, np.inf])] * 2]) == np.inf
    assert median_error([]) is None


def test_bounds_of_a_cell_follow_its_noise() -> None:
    once = grid(noise=(NoiseLevel(0.001, 0.01),), noise_model="gaussian").cells()[0]
    noise = once.options.noise
    assert isinstance(noise, GaussianNoise)
    twice = replace(once, options=replace(once.options, noise=replace(noise, translation_m=0.002, rotation_rad=0.02)))
    uniform = replace(once, options=replace(once.options, noise=UniformNoise(np.sqrt(3) * 0.001, np.sqrt(3) * 0.01)))
    least = cell_bounds(once, TREE)
    assert [bound.joint for bound in least] == [joint.name for joint in TREE.joints]
    for one, two, same in zip(least, cell_bounds(twice, TREE), cell_bounds(uniform, TREE), strict=True):
        assert one.axis_rad is not None and two.axis_rad == pytest.approx(2 * one.axis_rad)
        assert same.axis_rad == pytest.approx(one.axis_rad)  # a uniform number has a third of its bound's square


def test_a_cell_without_noise_has_no_bounds() -> None:
    cell = grid(noise=(NoiseLevel(0.0, 0.0),)).cells()[0]
    assert cell_bounds(cell, TREE) == ()


def test_stored_fits_are_read_from_the_sweep_s_folder(tmp_path: Path) -> None:
    """As `MadeSweep` is a short cut, the way by the file is held against it once."""
    from station.experiments.store import FITS_FOLDER, fit_file

    sweep = made_sweep(tmp_path)
    first = sweep.rows[0]
    path = tmp_path / FITS_FOLDER / fit_file(first.cell)
    path.parent.mkdir(parents=True)
    path.write_text(to_json(TREE))
    read = attempt_of(Sweep(tmp_path, sweep.grid, sweep.rows), first, "slide")
    assert read.joint is not None
    q = np.linspace(0, 0.1, 5)
    np.testing.assert_allclose(read.joint.forward(q), TREE.joint("slide").forward(q), atol=1e-12)
