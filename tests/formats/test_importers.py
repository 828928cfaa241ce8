"""Every importer of the registry: random logs come back, and whatever is wrong in a row is refused with its number.

A new importer needs a writer here, made without the station's own.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from station.errors import InvalidFile
from station.formats.read import IMPORTERS, Importer, read_pose_log
from station.kinematics import se3
from station.logs import PoseLog

PARTS = ("marker_3", "marker_12")
by_importer = pytest.mark.parametrize("importer", IMPORTERS, ids=lambda importer: importer.name)
examples = settings(max_examples=40)


def random_log(frames: int, seed: int, *, gaps: bool) -> PoseLog:
    """Two parts at uneven times, in front of a camera; in each frame at least one of them."""
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(size=(frames, 2, 6)))
    if gaps:
        T[np.arange(frames), rng.integers(0, 2, frames)] = np.nan
        T[0] = se3.exp(rng.normal(size=(2, 6)))  # parts in their order
    return PoseLog(np.cumsum(rng.uniform(0.01, 2.0, frames)) - 3, "world", PARTS, T)


def rows(log: PoseLog) -> list[tuple[float, str, list[float], Rotation]]:
    return [
        (float(log.t_s[t]), log.parts[k], log.T_ref_part[t, k, :3, 3].tolist(), Rotation.from_matrix(R))
        for t, k in np.argwhere(log.seen)
        for R in [log.T_ref_part[t, k, :3, :3]]
    ]


def write_poses_csv(log: PoseLog) -> list[str]:
    cells = ([t, part, *xyz, R.as_quat()[3], *R.as_quat()[:3]] for t, part, xyz, R in rows(log))
    return ["t_s,part,x_m,y_m,z_m,qw,qx,qy,qz", *(",".join(map(str, row)) for row in cells)]


def write_legacy(log: PoseLog) -> list[str]:
    """Equation 26 is Rx(-rx) Ry(ry) Rz(rz)."""
    lines = ["t_s,id,tx,ty,tz,rx,ry,rz"]
    for t, part, xyz, R in rows(log):
        angles = R.as_euler("XYZ") * (-1, 1, 1)
        lines.append(",".join(map(str, [t, part.removeprefix("marker_"), *xyz, *angles])))
    return lines


def write_tum(log: PoseLog) -> list[str]:
    return [" ".join(map(str, [t, *xyz, *R.as_quat()])) for t, part, xyz, R in rows(log) if part == PARTS[0]]


def write_track(log: PoseLog) -> list[str]:
    return [" ".join(map(str, [*xyz, *R.as_quat()])) for _, part, xyz, R in rows(log) if part == PARTS[0]]


WRITERS: dict[str, Callable[[PoseLog], list[str]]] = {
    "poses.csv": write_poses_csv,
    "legacy ArUco": write_legacy,
    "TUM": write_tum,
    "track": write_track,
}
WITHOUT_TIMES = ("track",)
OF_ONE_PART = ("TUM", "track")


def read(importer: Importer, lines: list[str], folder: Path, ending: int = 0) -> PoseLog:
    path = folder / f"marker_3{importer.endings[ending]}"
    path.write_text("\n".join(lines), "utf-8")
    return read_pose_log(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


@by_importer
@given(frames=st.integers(1, 12), seed=st.integers(0, 10**6), gaps=st.booleans())
@examples
def test_a_random_log_comes_back(importer: Importer, folder: Path, frames: int, seed: int, gaps: bool) -> None:
    log = random_log(frames, seed, gaps=gaps)
    for ending in range(len(importer.endings)):
        again = read(importer, WRITERS[importer.name](log), folder, ending)
        columns = [0] if importer.name in OF_ONE_PART else [0, 1]
        there = log.seen[:, columns].any(axis=1)
        assert again.parts == tuple(PARTS[k] for k in columns)
        times = np.arange(there.sum()) if importer.name in WITHOUT_TIMES else log.t_s[there]
        np.testing.assert_array_equal(again.t_s, times)
        np.testing.assert_allclose(again.T_ref_part, log.T_ref_part[there][:, columns], atol=1e-12)


def damaged(line: str, column: int, cell: str | None) -> str:
    """The line with another cell there, or without it."""
    mark = "," if "," in line else " "
    cells = line.split(mark)
    cells[column : column + 1] = [] if cell is None else [cell]
    return mark.join(cells)


@by_importer
@given(
    seed=st.integers(0, 10**6),
    row=st.integers(1, 7),
    column=st.integers(0, 8),
    cell=st.sampled_from(["nan", "inf", "-inf", "1e999", "one", "1,5", "0x10", "--1", None, ""]),
)
@examples
def test_what_is_wrong_in_a_row_is_refused_with_its_number(
    importer: Importer, folder: Path, seed: int, row: int, column: int, cell: str | None
) -> None:
    log = random_log(10, seed, gaps=False)
    lines = WRITERS[importer.name](log)
    first = len(lines) - len(rows(log)) if importer.name not in OF_ONE_PART else 0
    at = first + row  # never the first row of data, which may choose the importer
    assume(column < len(lines[at].replace(",", " ").split()))
    assume(not (importer.name == "poses.csv" and column == 1))  # a name, which most words are
    lines[at] = damaged(lines[at], column, cell)
    with pytest.raises(InvalidFile, match=rf"^marker_3\.\w+, row {at + 1}: "):
        read(importer, lines, folder)


@by_importer
@given(seed=st.integers(0, 10**6), row=st.integers(2, 7))
@examples
def test_times_that_fall_are_refused_with_the_row(importer: Importer, folder: Path, seed: int, row: int) -> None:
    if importer.name in WITHOUT_TIMES:
        return
    lines = WRITERS[importer.name](random_log(10, seed, gaps=False))
    lines[row] = damaged(lines[row], 0, "-99")
    with pytest.raises(InvalidFile, match=rf"^marker_3\.\w+, row {row + 1}: t(_s)? -99 follows .*times"):
        read(importer, lines, folder)


@by_importer
@given(text=st.text(max_size=80))
@examples
def test_any_text_is_a_log_or_a_refusal(importer: Importer, folder: Path, text: str) -> None:
    path = folder / f"marker_3{importer.endings[0]}"
    path.write_text(text, "utf-8", newline="")
    try:
        log = read_pose_log(path)
    except InvalidFile as refusal:
        assert path.name in str(refusal) and str(refusal).count("\n") <= 4
    else:
        assert log.seen.any()


def test_a_file_of_two_forms_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "both.csv"
    path.write_text("t_s,part,id,x_m,y_m,z_m,qw,qx,qy,qz\n0,lid,3,0,0,1,1,0,0,0\n", "utf-8")
    with pytest.raises(InvalidFile, match=r"both\.csv may be poses\.csv or legacy ArUco: .*leave the columns of one"):
        read_pose_log(path)


@by_importer
def test_every_importer_has_one_of_the_files_that_fit_reads(importer: Importer, station, tmp_path: Path) -> None:
    """A door: every form is fitted directly, by `station fit`."""
    swing = se3.rotation_z(np.linspace(0, 1.2, 40))
    noise = se3.exp(np.random.default_rng(0).normal(size=(40, 2, 6)) * 2e-3)
    still = np.broadcast_to(np.eye(4), (40, 4, 4))
    T = np.stack([se3.translation([0.3, 0.1, 1.0]) @ swing @ se3.translation([0.4, 0, 0]), still], axis=1) @ noise
    log = PoseLog(np.arange(40) / 30, "world", PARTS, T)
    path = tmp_path / f"marker_3{importer.endings[0]}"
    path.write_text("\n".join(WRITERS[importer.name](log)), "utf-8")
    code, out, err = station("fit", path, "--out", tmp_path / "fit")
    assert code == 0 and "revolute" in out, err


def test_a_folder_of_tum_files_is_fitted_as_one_log(station, tmp_path: Path) -> None:
    swing = se3.rotation_z(np.linspace(0, 1.2, 40))
    noise = se3.exp(np.random.default_rng(1).normal(size=(40, 2, 6)) * 2e-3)
    frame = np.broadcast_to(se3.translation([0.1, 0.0, 1.0]), (40, 4, 4))
    T = np.stack([frame @ swing @ se3.translation([0.4, 0, 0]), frame], axis=1) @ noise
    (tmp_path / "run").mkdir()
    for k, part in enumerate(("door", "frame")):
        log = PoseLog(np.arange(40) / 30, "world", (PARTS[0],), T[:, [k]])
        (tmp_path / "run" / f"{part}.txt").write_text("\n".join(write_tum(log)), "utf-8")
    code, out, err = station("fit", tmp_path / "run", "--out", tmp_path / "fit")
    assert code == 0 and "revolute" in out and "frame > door" in out, err
