"""`station fit` on whatever file it is given: one short error that names it, or a result that says what is wrong."""

from __future__ import annotations

import csv
import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from station import cli

COLUMNS = "t_s,part,x_m,y_m,z_m,qw,qx,qy,qz"
FRAMES = 30
MAX_ERROR_LINES = 5

Run = Callable[..., tuple[int, str]]


@pytest.fixture
def fit(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Runs `station fit` in an empty folder; returns its exit code and standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str]:
        before = signal.getsignal(signal.SIGTERM)
        monkeypatch.setattr(sys, "argv", ["station", "fit", *map(str, arguments)])
        try:
            with pytest.raises(SystemExit) as end:
                cli.main()
        finally:
            signal.signal(signal.SIGTERM, before)
        return int(end.value.code or 0), capsys.readouterr().err

    return call


def door(frames: int = FRAMES, *, start_s: float = 0.0, size: float = 1.0, travel_rad: float = 1.0) -> list[str]:
    """Rows of a door that turns about the z axis through (1, 0, 0), with noise."""
    rng = np.random.default_rng(80)
    turn = Rotation.from_rotvec(np.linspace(0.0, travel_rad, frames)[:, None] * [0.0, 0.0, 1.0])
    xyz = size * ([1.0, 0.0, 0.0] + turn.apply([0.5, 0.0, 0.0]) + 0.001 * rng.normal(size=(frames, 3)))
    xyzw = (turn * Rotation.from_rotvec(0.01 * rng.normal(size=(frames, 3)))).as_quat()
    wxyz = xyzw[:, [3, 0, 1, 2]]
    return [
        ",".join([f"{start_s + i / 8!r}", "door", *map(repr, (*p.tolist(), *q.tolist()))])
        for i, (p, q) in enumerate(zip(xyz, wxyz, strict=True))
    ]


def with_cell(row: int, column: str, cell: str) -> str:
    """The door's file, with one cell of a data row, counted from 0, replaced."""
    rows = [line.split(",") for line in door()]
    rows[row][COLUMNS.split(",").index(column)] = cell
    return "\n".join([COLUMNS, *(",".join(cells) for cells in rows)])


def with_row(*rows: str, header: str = COLUMNS) -> str:
    return "\n".join([header, *door(), *rows])


TRACK = "\n".join(f"{0.01 * i} 0 0 0 0 0 1" for i in range(FRAMES))
TUM = "\n".join(f"{0.1 * i} {0.01 * i} 0 0 0 0 0 1" for i in range(FRAMES))
# The file, what it holds, what is said of it. Rows as an editor counts them: the header is row 1.
REFUSED: dict[str, tuple[str, str | bytes, str]] = {
    "NaN": ("a.csv", with_cell(7, "x_m", "nan"), "a.csv, row 9: x_m is 'nan'; want a finite number"),
    "inf": ("a.csv", with_cell(7, "qx", "-inf"), "a.csv, row 9: qx is '-inf'; want a finite number"),
    "a number beyond floats": ("a.csv", with_cell(7, "x_m", "1e400"), "a.csv, row 9: x_m is '1e400'; want a finite"),
    "a text": ("a.csv", with_cell(7, "y_m", "0,5"), "a.csv, row 9: 10 cells; want 9"),
    "a time that is a text": ("a.csv", with_cell(7, "t_s", "12:30"), "a.csv, row 9: t_s is '12:30'; want a number"),
    "a blank position": ("a.csv", with_cell(7, "z_m", ""), "a.csv, row 9: z_m is blank; want a number"),
    "half a quaternion": ("a.csv", with_cell(7, "qw", ""), "a.csv, row 9: part of the quaternion is blank"),
    "a scaled quaternion": ("a.csv", with_cell(7, "qw", "1.5"), "a.csv, row 9: quaternion of length 1.5"),
    "a huge quaternion": (
        "a.csv",
        with_cell(7, "qw", "1e300"),
        "a.csv, row 9: quaternion of length 1e+12; want 1 within",
    ),
    "no quaternion": ("a.csv", with_row("9,door,0,0,0,0,0,0,0"), "a.csv, row 32: quaternion of length 0; want 1"),
    "what is too far": (
        "a.csv",
        with_cell(7, "x_m", "-1e200"),
        "a.csv, row 9: x_m is -1e+200; want metres, 1e+12 at most",
    ),
    "times that fall": ("a.csv", with_cell(7, "t_s", "0.1"), "a.csv, row 9: t_s 0.1 follows 0.75; want rows in which"),
    "times beyond floats": (
        "a.csv",
        with_row("1e308" + door()[0][3:], "-1e308" + door()[0][3:]),
        "a.csv, row 33: t_s -1e+308",
    ),
    "a part twice": ("a.csv", with_cell(7, "t_s", "0.75"), "a.csv, row 9: part 'door' is there twice at t = 0.75 s"),
    "a name that is none": ("a.csv", with_cell(7, "part", "The door"), "a.csv, row 9: 'The door' is no part's name"),
    "no name": ("a.csv", with_cell(7, "part", ""), "a.csv, row 9: '' is no part's name"),
    "a short row": ("a.csv", with_row("9,door,0,0"), "a.csv, row 32: 4 cells; want 9"),
    "a deviation below zero": (
        "a.csv",
        f"{COLUMNS},std_m,std_rad\n" + "\n".join(f"{row},0.001,-0.01" for row in door()),
        "a.csv, row 2: std_rad is -0.01; want more than 0",
    ),
    "a deviation beyond squares": (
        "a.csv",
        f"{COLUMNS},std_m,std_rad\n" + "\n".join(f"{row},1e-200,0.01" for row in door()),
        "a.csv, row 2: std_m is 1e-200; want more than 0 (1e-12 to 1e+12)",
    ),
    "a missing column": ("a.csv", with_row(header=COLUMNS.replace(",qz", "")), "a.csv, row 2: 9 cells; want 8"),
    "another column": ("a.csv", with_row(header=COLUMNS.replace("x_m", "x_mm")), "a.csv: no column x_m; want t_s,part"),
    "a column twice": (
        "a.csv",
        with_row(header=COLUMNS.replace("qx", "qw")),
        "a.csv, row 1: column 'qw' is there twice",
    ),
    "no header": ("a.csv", "\n".join(door()), "a.csv has the columns 0.0,door"),
    "a header alone": ("a.csv", COLUMNS, "a.csv has no data below its header"),
    "nothing": ("a.csv", "", "a.csv is empty"),
    "blank lines": ("a.csv", "\n\n \n", "a.csv is empty"),
    "bytes": ("a.csv", b"\x89PNG\r\n\x1a\n\xff\x00", "can't read pose log 'a.csv'"),
    "zero bytes": ("a.csv", COLUMNS + "\n\0\0\0", "a.csv"),
    "a cell without an end": ("a.csv", COLUMNS + '\n"' + 200_000 * "x", "a.csv, row "),
    "another ending": ("a.xlsx", with_row(), "a.xlsx ends in '.xlsx'"),
    "two frames": ("a.csv", "\n".join([COLUMNS, *door(2)]), "10 frames or more; seen: door 2 of 2 frames"),
    "a track with NaN": ("a.log", TRACK + "\nnan 0 0 0 0 0 1", "a.log, row 31: x is 'nan'; want a finite number"),
    "a track of two widths": ("a.log", TRACK + "\n0 0 0", "a.log, row 31: 3 cells; want 7"),
    "a track of five numbers": ("a.log", "1 2 3 4 5", "a.log has 5 numbers in its first row"),
    "a track of scaled rotations": ("a.log", TRACK + "\n0 0 0 0 0 0 2", "a.log, row 31: quaternion of length 2"),
    "a trajectory with a time twice": ("a.txt", TUM + "\n2.9 0 0 0 0 0 0 1", "a.txt, row 31: t 2.9 follows 2.9"),
}


def files_in(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def is_one_clear_error(err: str) -> bool:
    return err.startswith("error: ") and len(err.splitlines()) <= MAX_ERROR_LINES and "Traceback" not in err


@pytest.mark.parametrize(("name", "content", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_a_bad_file_is_one_clear_error_with_its_row_and_leaves_nothing(
    fit: Run, tmp_path: Path, name: str, content: str | bytes, message: str
):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    code, err = fit(name, "--out", "out")
    assert code == 1, err
    assert is_one_clear_error(err) and message in err and name in err
    assert files_in(tmp_path) == {name}


def test_what_is_no_file_or_holds_none_is_refused(fit: Run, tmp_path: Path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "tracks").mkdir()
    (tmp_path / "tracks" / "a.log").write_text(TRACK)
    (tmp_path / "tracks" / "b.log").write_text(TRACK)
    before = files_in(tmp_path)
    for source, message in (
        ("gone.csv", "no input 'gone.csv'"),
        ("empty", "empty is a folder without .log, .txt, .tum files"),
        ("tracks", "a.log is no TUM trajectory"),
    ):
        code, err = fit(source, "--out", "out")
        assert code == 1 and is_one_clear_error(err) and message in err, err
    assert files_in(tmp_path) == before


def test_a_folder_for_the_result_that_is_none_is_refused_and_left_alone(fit: Run, tmp_path: Path):
    (tmp_path / "door.csv").write_text(with_row())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    before = files_in(tmp_path)
    for out, message in (
        ("mine", "mine exists and isn't empty"),
        ("door.csv", "door.csv is a file; want a folder"),
        ("door.csv/fit", "can't write the fit into 'door.csv/fit'"),
    ):
        code, err = fit("door.csv", "--out", out)
        assert code == 1 and is_one_clear_error(err) and message in err, err
    code, err = fit("door.csv")
    assert code == 1 and "name a folder for the result with --out" in err
    assert files_in(tmp_path) == before


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--criterion", "best", "criterion 'best' is unknown; choose one of evidence"),
        ("--joint-types", "rigid,hinge", "want one or more of rigid, prismatic, revolute, screw"),
        ("--joint-types", "", "want one or more of rigid, prismatic, revolute, screw"),
        ("--root", "wall", "no part 'wall' for a root; have door, world"),
    ],
)
def test_options_that_do_not_exist_are_refused_with_the_choices(
    fit: Run, tmp_path: Path, option: str, value: str, message: str
):
    (tmp_path / "door.csv").write_text(with_row())
    code, err = fit("door.csv", "--out", "out", option, value)
    assert code == 1 and is_one_clear_error(err) and message in err, err
    assert files_in(tmp_path) == {"door.csv"}


# --- Unusual, and fitted ---------------------------------------------------------------------------------------------


def tree_in(folder: Path) -> dict[str, list[dict[str, str]]]:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    return json.loads((folder / "kinematics.json").read_text("utf-8"), parse_constant=refuse)


@pytest.mark.parametrize(
    "rows",
    [
        door(start_s=1e6),
        door(start_s=-1e6),
        door(size=1e9),
        door(size=1e-9),
        door(10),
        [f"{row}\r" for row in door()],
        [row.replace(",", " , ") for row in door()],
    ],
    ids=["late", "early", "huge", "tiny", "ten frames", "of Windows", "with blanks"],
)
def test_unusual_numbers_are_a_door_all_the_same(fit: Run, tmp_path: Path, rows: list[str]):
    (tmp_path / "door.csv").write_text("\n".join([COLUMNS, *rows]))
    code, err = fit("door.csv", "--out", "out")
    assert code == 0, err
    assert [joint["type"] for joint in tree_in(tmp_path / "out")["joints"]] == ["revolute"]
    with (tmp_path / "out" / "joint_states.csv").open() as file:
        states = list(csv.DictReader(file))
    assert [row["t_s"] for row in states] == [row.split(",")[0].strip() for row in rows]  # to the last digit
    swing = float(states[-1]["world__door"]) - float(states[0]["world__door"])
    assert swing == pytest.approx(1.0, abs=0.05)  # rad; two poses of 0.01 rad


def test_a_door_that_stands_still_is_said_to(fit: Run, tmp_path: Path):
    (tmp_path / "door.csv").write_text("\n".join([COLUMNS, *door(travel_rad=0.0)]))
    code, err = fit("door.csv", "--out", "out")
    assert code == 0 and "warning: no part moved" in err
    assert tree_in(tmp_path / "out")["joints"] == [] and (tmp_path / "out" / "kinematics.urdf").exists()


def test_a_part_of_one_row_is_named_in_a_warning(fit: Run, tmp_path: Path):
    still = [f"{row.split(',')[0]},wall,0,0,0,1,0,0,0" for row in door()]
    rows = [row for pair in zip(door(), still, strict=True) for row in pair]
    (tmp_path / "door.csv").write_text("\n".join([COLUMNS, *rows, f"{door()[-1].split(',')[0]},lamp,1,1,1,1,0,0,0"]))
    code, err = fit("door.csv", "--out", "out", "--root", "wall")
    assert code == 0 and f"warning: lamp was seen in 1 of {FRAMES} frames" in err
    tree = tree_in(tmp_path / "out")
    assert [(joint["parent"], joint["child"]) for joint in tree["joints"]] == [("wall", "door")]
    assert ["lamp"] in tree["trees"]


@pytest.mark.parametrize("smoother", ["lowpass:1", "kalman"])
def test_poses_are_smoothed_when_asked(fit: Run, tmp_path: Path, smoother: str) -> None:
    header, *rows = [f"{COLUMNS},std_m,std_rad", *(f"{row},0.001,0.01" for row in door(60))]
    (tmp_path / "door.csv").write_text("\n".join([header, *rows]))
    assert fit("door.csv", "--out", "plain")[0] == 0
    assert fit("door.csv", "--out", "smooth", "--smooth", smoother)[0] == 0
    plain, smooth = ((tmp_path / name / "joint_states.csv").read_text() for name in ("plain", "smooth"))
    assert plain != smooth


def test_a_smoother_that_there_is_not_is_an_error_with_the_choices(fit: Run, tmp_path: Path) -> None:
    (tmp_path / "door.csv").write_text("\n".join([COLUMNS, *door()]))
    code, err = fit("door.csv", "--out", "out", "--smooth", "median")
    assert code == 1 and "lowpass:HZ" in err and "kalman" in err
    assert len(err.strip().splitlines()) <= MAX_ERROR_LINES


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--refine", "image"), ["poses.csv is a log of poses, which has no corners", "--refine pose"]),
        (("--refine", "image", "--smooth", "lowpass:2"), ["smoothing is of poses", "leave out --smooth"]),
        (("--refine", "pose", "--method", "paper"), ["poses.csv", "method 'paper' can't refine on 'pose'", "'none'"]),
        (("--root-static", "no"), ["poses.csv", "is a part of the tree and stands still"]),
    ],
)
def test_what_a_log_of_poses_cannot_be_refined_on_is_said_with_what_to_do(
    fit: Run, options: tuple[str, ...], said: list[str]
) -> None:
    Path("poses.csv").write_text("\n".join([COLUMNS, *door()]))
    code, error = fit("poses.csv", "--out", "fit", *options)
    assert code == 1
    for words in said:
        assert words in error
    assert len(error.splitlines()) <= MAX_ERROR_LINES


def test_a_number_of_the_camera_that_cannot_be_estimated_is_wrong_usage(fit: Run) -> None:
    Path("poses.csv").write_text("\n".join([COLUMNS, *door()]))
    code, error = fit("poses.csv", "--out", "fit", "--estimate", "focal,zoom")
    assert code == 2
    assert "want focal, readout" in " ".join(error.replace("\u2502", " ").split())
