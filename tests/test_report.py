"""Claims of station/report/: what the figures show, that nothing overlaps, that the report is one safe, small file."""

import io
import itertools
import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import asdict, replace

import numpy as np
import pytest
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from station.compare import Comparison, JointComparison, compare
from station.comparison_files import write_files
from station.fit.result import Fit
from station.kinematics.tree import Joint, KinematicTree
from station.logs import JointLog
from station.report import Material, figure7, save_figure, summary_rows, tree_figure, tree_rows, write_report
from station.report.drawings import COLUMN_PT, TOLERANCE_PT, compact, svg
from station.report.style import DARK, LIGHT
from tests.made_reports import timing

NAMES = ("base_pan", "shoulder", "elbow", "wrist")
CHAIN = ("base", "link1", "link2", "link3", "hand")
TARGETS_DEG = np.array([[0, 0, 0, 0], [80, 0, 0, 0], [-80, 30, 0, 0], [0, -20, 60, 0], [0, 0, -40, 50], [0, 0, 0, 0]])


def logs(unit: str = "rad", count: int = 4) -> tuple[JointLog, JointLog, JointLog]:
    """Detected, commanded, measured: steps of 4 s, ramps of 1.5 s, noise that grows with the first joint's angle."""
    scale = np.radians(1.0) if unit == "rad" else 1e-3
    times = np.arange(len(TARGETS_DEG)) * 4.0
    corners_s = np.stack([times, times + 1.5], -1).ravel()

    def state(column: int, t_s):
        targets = scale * TARGETS_DEG[:, column]
        return np.interp(t_s, corners_s, np.stack([np.roll(targets, 1), targets], -1).ravel())

    t_s, servo_s = np.arange(0, 24, 1 / 15), np.arange(0, 24, 0.02)
    units = (unit,) * count
    true = np.stack([state(column, t_s) for column in range(count)], -1)
    std = scale * (0.1 + np.abs(true[:, :1] / scale / 80) ** 4) * np.ones(count)
    q = true + std * np.random.default_rng(0).normal(size=true.shape)
    q[100:110] = np.nan
    detected = JointLog(t_s, tuple(f"{a}__{b}" for a, b in itertools.pairwise(CHAIN[: count + 1])), q, units, std)
    measured = np.stack([state(column, servo_s) for column in range(count)], -1)
    commanded = JointLog(times, NAMES[:count], scale * TARGETS_DEG[:, :count], units)
    return detected, commanded, JointLog(servo_s, NAMES[:count], measured, units)


def compared(unit: str = "rad", count: int = 4) -> Comparison:
    detected, commanded, measured = logs(unit, count)
    kind = "revolute" if unit == "rad" else "prismatic"
    return compare(detected, commanded, measured, types=dict.fromkeys(detected.joints, kind))


def viewing(comparison: Comparison):
    return {joint.joint: (joint.t_s, np.abs(np.degrees(comparison.joints[0].detected))) for joint in comparison.joints}


def joint_between(name: str, parent: str, child: str, kind: str = "revolute") -> Joint:
    point = np.zeros(3) if kind == "revolute" else None
    return Joint(name, kind, parent, child, np.array([0, 0, 1.0]), point, np.eye(4), state_min=-0.5, state_max=0.6)


def arm() -> KinematicTree:
    joints = tuple(joint_between(f"{a}__{b}", a, b) for a, b in itertools.pairwise(CHAIN))
    return KinematicTree("base", (*CHAIN, "base_b"), (("base", "base_b"),), (CHAIN,), joints)


def wide_tree() -> KinematicTree:
    """A chest of eight drawers with long names, and a door apart from it."""
    bodies = ("chest", *(f"drawer_with_a_long_name_{i}" for i in range(8)))
    joints = [joint_between(f"rail_{i}", "chest", body, "prismatic") for i, body in enumerate(bodies[1:])]
    door = joint_between("frame__door", "frame", "door")
    return KinematicTree("chest", (*bodies, "frame", "door"), (), (bodies, ("frame", "door")), (*joints, door))


def states_of(tree: KinematicTree) -> JointLog:
    t_s = np.linspace(0, 10, 60)
    q = np.stack([np.sin(t_s + i) for i in range(len(tree.joints))], -1)
    units = tuple("m" if joint.type == "prismatic" else "rad" for joint in tree.joints)
    return JointLog(t_s, tuple(joint.name for joint in tree.joints), q, units, np.full(q.shape, 0.1))


def texts_that_overlap(figure) -> list[tuple[str, str]]:
    """Pairs of texts whose boxes cross by more than half a pixel, or that leave the figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    hidden = {
        label
        for axes in figure.axes
        for axis in (axes.xaxis, axes.yaxis)
        for tick in axis.get_major_ticks() + axis.get_minor_ticks()
        for label in (tick.label1, tick.label2)
        if not label.get_visible() or not _within(axes, axis, tick.get_loc())
    }
    shown = [t for t in figure.findobj(Text) if t.get_visible() and t.get_text().strip() and t not in hidden]
    boxes = [(text.get_text(), text.get_window_extent(renderer).padded(-0.5)) for text in shown if _drawn(text)]
    wrong = [(a, b) for (a, box), (b, other) in itertools.combinations(boxes, 2) if Bbox.intersection(box, other)]
    outside = [
        (name, "the edge")
        for name, box in boxes
        if box.x0 < 0 or box.y0 < 0 or box.x1 > figure.bbox.x1 or box.y1 > figure.bbox.y1
    ]
    return wrong + outside


def _drawn(text) -> bool:
    return text.axes is None or text.axes.axison or text in text.axes.texts


def _within(axes, axis, location: float) -> bool:
    low, high = axes.get_xlim() if axis is axes.xaxis else axes.get_ylim()
    return low <= location <= high


def with_joints(comparison: Comparison, count: int) -> Comparison:
    """As many joints, with names up to 25 letters."""
    copies = itertools.islice(itertools.cycle(comparison.joints), count)
    named = (replace(joint, joint=f"{joint.joint}{'_of_the_left_arm' * (i > 3)}") for i, joint in enumerate(copies))
    return replace(comparison, joints=tuple(named))


@pytest.fixture(scope="module", autouse=True)
def _fonts_are_open(tmp_path_factory):
    """matplotlib keeps the fonts that it drew with open while the process lives: no single test leaves them behind."""
    save_figure(figure7(compared(count=1), None), tmp_path_factory.mktemp("fonts") / "figure")


def test_figure7_shows_every_joint_in_panels_with_units_and_one_legend():
    comparison = compared()
    figure = figure7(comparison, viewing(comparison))
    assert len(figure.axes) == 3 * 4
    assert [axes.get_ylabel() for axes in figure.axes[:3]] == ["angle [deg]", "error\n[deg]", "view\n[deg]"]
    assert len(figure.legends) == 1 and not any(axes.get_legend() for axes in figure.axes)
    for axes, joint in zip(figure.axes[::3], comparison.joints, strict=True):
        assert joint.against_measured is not None
        assert f"{joint.joint}: RMSE {np.degrees(joint.against_measured.rmse):.2f} deg" in axes.get_title(loc="left")


def test_the_drawn_error_is_detected_minus_readback_in_degrees():
    comparison = compared(count=1)
    joint = comparison.joints[0]
    lines = {line.get_label(): line for line in figure7(comparison, None).axes[1].get_lines()}
    drawn = lines["error: detected - rounded read-back"].get_ydata()
    np.testing.assert_allclose(drawn, np.degrees(joint.detected - joint.measured))


def test_the_legend_says_that_the_band_is_the_detections_alone_and_the_error_has_the_readbacks_rounding():
    legend = {text.get_text() for text in figure7(compared(count=1), None).legends[0].get_texts()}
    assert {"±2 std of the detection alone", "error: detected - rounded read-back"} <= legend


def test_oblique_views_are_shaded_where_the_angle_exceeds_sixty_degrees():
    comparison = compared(count=1)
    figure = figure7(comparison, viewing(comparison))
    t_s, angle_deg = viewing(comparison)["base_pan"]
    for axes in figure.axes:
        shade = next(c for c in axes.collections if str(c.get_label()).startswith("oblique"))
        spans = sorted((path.vertices[:, 0].min(), path.vertices[:, 0].max()) for path in shade.get_paths())
        inside = np.any([(t_s >= low) & (t_s <= high) for low, high in spans], axis=0)
        np.testing.assert_array_equal(inside, angle_deg > 60.0)


@pytest.mark.parametrize(("count", "with_viewing"), [(1, True), (4, False), (7, True)])
def test_no_text_of_figure7_overlaps(count, with_viewing):
    comparison = with_joints(compared(), count)
    figure = figure7(comparison, viewing(comparison) if with_viewing else None)
    assert texts_that_overlap(figure) == []


@pytest.mark.parametrize("tree", [arm(), wide_tree()], ids=["arm", "wide"])
def test_no_text_of_the_tree_figure_overlaps(tree):
    assert texts_that_overlap(tree_figure(tree, states_of(tree))) == []


def test_the_tree_figure_names_every_body_tracker_and_joint():
    tree = arm()
    drawn = " ".join(text.get_text() for axes in tree_figure(tree, states_of(tree)).axes for text in axes.texts)
    assert all(part in drawn for part in tree.parts)
    assert drawn.count("revolute, -29 to 34 deg") == 4


def test_a_ball_has_a_panel_with_its_three_states_and_a_screw_says_its_advance():
    ball = Joint("ball", "spherical", "base", "link1", None, np.zeros(3), np.eye(4), state_min=0.0, state_max=0.6)
    screw = replace(joint_between("bolt", "link1", "link2"), type="screw", pitch_m_per_rad=0.002)
    tree = KinematicTree("base", CHAIN[:3], (), (CHAIN[:3],), (ball, screw))
    t_s = np.linspace(0, 10, 60)
    q = np.stack([np.sin(t_s + i) for i in range(4)], -1)
    figure = tree_figure(tree, JointLog(t_s, tree.columns, q, ("rad",) * 4, np.full(q.shape, 0.1)))
    assert texts_that_overlap(figure) == []
    graph, panel, single = figure.axes
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["x", "y", "z"]
    drawn = {line.get_label(): line.get_ydata() for line in panel.get_lines()}
    np.testing.assert_allclose(drawn["z"], np.degrees(q[:, 2]))
    assert single.get_legend() is None
    said = {text.get_text() for text in graph.texts}
    assert {"ball: spherical, 0 to 34 deg", "bolt: screw, 12.6 mm/turn, -29 to 34 deg"} <= said
    assert [row[2:4] for row in tree_rows(tree)[1:]] == [
        *(["spherical", "0 to 34 deg"], ["screw, 12.6 mm/turn", "-29 to 34 deg"]),
    ]


def test_figures_cope_with_unknown_std_no_readback_millimetres_and_nothing_at_all(tmp_path):
    slides = compared("m", 1)
    bare: JointComparison = replace(
        slides.joints[0],
        detected_std=np.full(len(slides.joints[0].t_s), np.nan),
        measured=np.full(len(slides.joints[0].t_s), np.nan),
        against_measured=None,
    )
    figure = figure7(replace(slides, joints=(bare,)), None)
    assert figure.axes[0].get_ylabel() == "position [mm]"
    save_figure(figure, tmp_path / "bare")
    save_figure(figure7(Comparison(()), None), tmp_path / "empty")
    alone = KinematicTree("box", ("box",), (), (("box",),), ())
    save_figure(tree_figure(alone, JointLog(np.zeros(1), (), np.zeros((1, 0)), ())), tmp_path / "alone")
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{name}.{kind}" for name in ("bare", "empty", "alone") for kind in ("png", "svg")
    }


def test_the_same_data_makes_the_same_bytes_whatever_a_persons_matplotlibrc_says(tmp_path):
    import matplotlib

    comparison = compared(count=1)
    save_figure(figure7(comparison, viewing(comparison)), tmp_path / "a")
    with matplotlib.rc_context({"font.size": 20.0, "savefig.dpi": 30, "savefig.bbox": "tight", "lines.linewidth": 9.0}):
        save_figure(figure7(comparison, viewing(comparison)), tmp_path / "b")
    for kind in ("png", "svg"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()
    ElementTree.parse(tmp_path / "a.svg")


FACTS = {"state": "complete", "rig": "demo", "seed": "0"}
WARNING = "the camera trails the servos by 37.0 ms: set latency_s in [camera] <script>alert(1)</script>"


@pytest.fixture(scope="module")
def report_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("session") / "report"
    comparison = replace(compared(count=2), unmatched_commanded=("gripper",))
    detected, _, _ = logs()
    material = Material(
        "demo",
        FACTS,
        Fit(arm(), detected),
        comparison,
        viewing(comparison),
        warnings=(WARNING,),
        counts={"frames": 360, "dropped_frames": 0},
        timing=timing(360),
    )
    write_report(folder, material)
    return folder


def test_a_report_is_its_five_files_and_nothing_else(report_folder):
    expected = {"figure7.png", "figure7.svg", "report.html", "comparison.csv", "comparison.json"}
    assert {path.name for path in report_folder.iterdir()} == expected
    assert (report_folder / "figure7.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((report_folder / "comparison.json").read_text())["schema"] == "comparison/1"


def test_the_html_needs_no_other_file_and_runs_nothing(report_folder):
    page = (report_folder / "report.html").read_text()
    references = re.findall(r"(?:src|href)=\"([^\"]*)|url\(([^)]*)", page)
    assert references and all("".join(reference).startswith("#") for reference in references)
    assert "@import" not in page and "<script" not in page and "default-src 'none'" in page


def test_the_drawings_in_the_html_share_no_id_and_refer_to_their_own(report_folder):
    page = (report_folder / "report.html").read_text()
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(set(ids)) == len(ids)
    for drawing in re.findall(r"<svg.*?</svg>", page, re.DOTALL):
        own = set(re.findall(r' id="([^"]+)"', drawing))
        assert len({name.split("-")[0] for name in own}) == 1
        assert set(re.findall(r'(?:href="|url\()#([^")]+)', drawing)) == own


def test_every_section_has_a_heading_and_is_reached_from_the_top(report_folder):
    page = (report_folder / "report.html").read_text()
    named = re.findall(r'<section id="(\w+)" aria-labelledby="\1-title">\s*<h2 id="\1-title">[^<]+</h2>', page)
    assert named == ["summary", "joints", "errors", "tree", "fit", "timing"]
    assert re.findall(r'<a href="#(\w+)">', page) == named
    assert page.count("<h1>") == 1 and page.count("<h2") == len(named)
    assert re.findall(r"<svg", page) and page.count("<svg") == len(
        re.findall(r'role="img" aria-label="[^"]{20,}"', page)
    )


def test_every_colour_of_a_drawing_turns_dark_with_the_page(report_folder):
    page = (report_folder / "report.html").read_text()
    drawings = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    assert len(drawings) == 5 and not any(re.search(r"#[0-9a-f]{6}\b", drawing) for drawing in drawings)
    for role in set(re.findall(r"var\(--(\w+)\)", "".join(drawings))):
        assert f"--{role}: {getattr(LIGHT, role)};" in page and f"--{role}: {getattr(DARK, role)};" in page
    assert "@media screen and (prefers-color-scheme: dark)" in page and "@media print" in page
    assert len(set(asdict(LIGHT).values())) == len(asdict(LIGHT))


def test_the_html_says_numbers_facts_and_warnings(report_folder):
    page = (report_folder / "report.html").read_text()
    data = json.loads((report_folder / "comparison.json").read_text())
    text = re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL)
    for joint in data["joints"]:
        for value in (joint["joint"], f"{joint['measured']['rmse_deg']:.2f}", str(joint["measured"]["frames"])):
            assert value in text
    assert "set latency_s in [camera] &lt;script&gt;" in text and "gripper: no detected joint follows it" in text
    assert "the read-back's own rounding" in " ".join(text.split())
    assert all(fact in text for fact in FACTS)


def test_no_text_of_a_drawing_reaches_the_html():
    """Names are drawn as outlines: whatever they hold, the page can take the drawing as it is."""
    hostile = replace(compared(count=1).joints[0], joint="--><script>x</script>")
    assert "script" not in svg(figure7(Comparison((hostile,)), None)).decode()


def test_without_commands_the_report_is_the_tree_alone(tmp_path):
    detected, _, _ = logs()
    write_report(tmp_path, Material("door", fit=Fit(arm(), detected)))
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert "commanded, read-back" not in (tmp_path / "report.html").read_text().lower()


def test_a_report_in_which_nothing_follows_a_command_says_so(tmp_path):
    detected, _, _ = logs()
    write_report(tmp_path, Material("s", {}, Fit(arm(), detected), Comparison((), unmatched_commanded=("elbow",))))
    page = (tmp_path / "report.html").read_text()
    assert "No detected joint follows a command" in page and "elbow: no detected joint follows it" in page
    assert page.count("<svg") == 2 and '<h2 id="errors' not in page


def test_a_failed_write_leaves_what_was_there(tmp_path):
    write_files(tmp_path, {"a": b"old"})
    with pytest.raises(TypeError):
        write_files(tmp_path, {"a": b"new", "b": None})  # type: ignore[dict-item]
    assert [path.name for path in tmp_path.iterdir()] == ["a"] and (tmp_path / "a").read_bytes() == b"old"


def printed_width(rows: list[list[str]]) -> int:
    """Columns that rich takes for a table as the command line prints it, on a line that never ends."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in rows[0]:
        table.add_column(Text(name), no_wrap=True)
    for row in rows[1:]:
        table.add_row(*map(Text, row))
    console = Console(width=1000, file=io.StringIO())
    return console.measure(table).maximum


def test_the_comparison_fits_a_hundred_columns_whatever_the_names():
    comparison = compared()
    joints = tuple(
        replace(joint, joint=f"{joint.joint}_with_a_long_name", fitted_joint="a_long_parent__a_long_child", sign=-1)
        for joint in comparison.joints
    )
    rows = summary_rows(replace(comparison, joints=joints))
    assert len({len(row) for row in rows}) == 1 and len(rows) == 1 + len(joints)
    assert 90 < printed_width(rows) <= 100


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_the_tree_fits_a_hundred_columns_whatever_the_names(kind):
    joint = joint_between("a_joint_with_a_long_name", "left_upper_drawer_of_it", "right_lower_drawer_of_it", kind)
    fitted = {"probability": {kind: 1.0}, "rms_rotation_rad": 3.0, "rms_translation_m": 1.234, "frames": 123456}
    joint = replace(joint, state_min=-1.2345, state_max=2.3456, **fitted)
    rows = tree_rows(
        KinematicTree(joint.parent, (joint.parent, joint.child), (), ((joint.parent, joint.child),), (joint,))
    )
    assert 90 < printed_width(rows) <= 100


def test_names_that_fit_are_whole_and_long_ones_keep_both_ends():
    assert [row[1] for row in tree_rows(arm())[1:]] == [f"{a} > {b}" for a, b in itertools.pairwise(CHAIN)]
    between = [row[1] for row in tree_rows(wide_tree())[1:9]]
    assert len(set(between)) == 8 and all(name.startswith("chest > drawer") for name in between)


def test_the_terminal_table_tells_the_numbers_of_the_comparison():
    comparison = compared()
    row = summary_rows(comparison)[1]
    joint = comparison.joints[0]
    assert joint.against_measured is not None and joint.against_measured.lag_std_s is not None
    rmse, mae, largest = (
        np.degrees(value)
        for value in (joint.against_measured.rmse, joint.against_measured.mae, joint.against_measured.max)
    )
    assert row[:4] == ["base_pan", "revolute", "base__link1", f"{rmse:.2f}/{mae:.2f}/{largest:.2f}°"]
    assert row[5].startswith(f"{1e3 * joint.against_measured.lag_s:.2f}")


def test_tree_rows_have_a_row_a_joint():
    tree = arm()
    elbow = {"probability": {"revolute": 0.9991, "free": 0.0009}, "rms_rotation_rad": np.radians(0.104), "frames": 824}
    named = replace(tree.joints[1], name="elbow", rms_translation_m=0.000254, **elbow)
    rows = tree_rows(replace(tree, joints=(tree.joints[0], named, *tree.joints[2:])))
    assert rows[0] == ["joint", "between", "type", "range", "prob.", "rms\n[deg]", "rms\n[mm]", "frames"]
    assert len(rows) == 1 + 4
    assert rows[1] == ["-", "base > link1", "revolute", "-29 to 34 deg", "", "", "", ""]
    assert rows[2] == ["elbow", "link1 > link2", "revolute", "-29 to 34 deg", "0.999", "0.10", "0.25", "824"]


def wave(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """A noisy wave over 300 pt, about a panel's width."""
    x = np.linspace(0, 300, frames)
    return x, 50 + 20 * np.sin(x / 9) + np.random.default_rng(1).normal(size=frames)


def compacted(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The corners of the curve as a browser finds them in the compact drawing."""
    drawn = "M " + "\nL ".join(f"{a:.6f} {b:.6f} " for a, b in zip(x, y, strict=True))
    ((first, steps),) = re.findall(r' d="M([^l]+)l([^z"]+)', compact(f'<path d="{drawn}"/>'))
    return np.cumsum(np.array(f"{first} {steps}".split(), float).reshape(-1, 2), axis=0)


# The simplification's tolerance, and as much for steep parts, where it is measured across the line.
ALLOWED_PT = 2 * TOLERANCE_PT


def test_a_compact_curve_passes_where_it_was_drawn():
    x, y = wave(300)
    corners = compacted(x, y)
    assert np.abs(np.interp(x, *corners.T) - y).max() < ALLOWED_PT


def test_a_dense_compact_curve_keeps_its_extremes_and_is_bounded():
    x, y = wave(30_000)
    corners = compacted(x, y)
    assert len(corners) <= 4 * (300 / COLUMN_PT + 1)
    for low in np.arange(0, 300, 5.0):
        for one, other in (((x, y), corners.T), (corners.T, (x, y))):
            inside = one[1][(one[0] >= low) & (one[0] <= low + 5)]
            around = other[1][(other[0] >= low - COLUMN_PT) & (other[0] <= low + 5 + COLUMN_PT)]
            assert inside.max() < around.max() + ALLOWED_PT and inside.min() > around.min() - ALLOWED_PT


def test_importing_the_report_does_not_import_matplotlib():
    code = "import sys, station.report; sys.exit('matplotlib' in sys.modules or 'jinja2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
