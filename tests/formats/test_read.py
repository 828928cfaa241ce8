"""read_pose_log picks the importer by ending and first line, and says what it can read."""

from pathlib import Path

import numpy as np
import pytest

from station.errors import InvalidFile
from station.formats.read import read_pose_log

TUM = "0 1 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n"
FILES = {
    "poses.csv": ("t_s,part,x_m,y_m,z_m,qw,qx,qy,qz\n0,base,1,0,0,1,0,0,0\n", ("base",), "world"),
    "legacy.csv": ("t_s,id,tx,ty,tz,rx,ry,rz\n0,4,1,0,0,0,0,0\n", ("marker_4",), "camera"),
    "door.log": ("1 0 0 0 0 0 1\n", ("door",), "world"),
    "3.txt": ("# made up\n1 0 0\n", ("track_3",), "world"),
    "lid.txt": (TUM, ("lid",), "world"),
    "Lid.TUM": (TUM, ("lid",), "world"),
}


def write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("name", FILES)
def test_each_form_is_read(tmp_path: Path, name: str):
    text, parts, reference = FILES[name]
    log = read_pose_log(write(tmp_path, name, text))
    assert (log.parts, log.reference) == (parts, reference)
    np.testing.assert_array_equal(log.T_ref_part[0, 0, :3, 3], [1, 0, 0])


def test_a_byte_order_mark_is_no_data(tmp_path: Path):
    assert read_pose_log(write(tmp_path, "poses.csv", "\ufeff" + FILES["poses.csv"][0])).parts == ("base",)


def test_a_folder_of_tum_files_is_several_parts(tmp_path: Path):
    for name in ("b.txt", "a.tum", "notes.md"):
        write(tmp_path, name, TUM)
    assert read_pose_log(tmp_path).parts == ("a", "b")


def test_several_tum_files_keep_their_order(tmp_path: Path):
    log = read_pose_log(*(write(tmp_path, name, TUM) for name in ("b.txt", "a.tum")))
    assert log.parts == ("b", "a")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    (
        ("poses.csv", "", "poses.csv is empty"),
        ("poses.csv", "t_s,pan\n0,1\n", "poses.csv has the columns t_s,pan"),
        ("x.log", "", "x.log is empty"),
        ("x.log", "1 2 3 4 5\n", "x.log has 5 numbers in its first row"),
        ("x.bag", "anything", "x.bag ends in '.bag'"),
        ("poses", "anything", "poses has no ending"),
    ),
)
def test_what_cannot_be_read_is_refused_with_what_can(tmp_path: Path, name: str, content: str, message: str):
    with pytest.raises(InvalidFile, match=message) as refusal:
        read_pose_log(write(tmp_path, name, content))
    assert "can read .csv" in str(refusal.value)
    assert "TUM" in str(refusal.value)
    assert str(refusal.value).count("\n") <= 4


def test_an_error_names_the_file_and_the_row(tmp_path: Path):
    with pytest.raises(InvalidFile, match=r"poses\.csv, row 2: x_m is 'one'"):
        read_pose_log(write(tmp_path, "poses.csv", FILES["poses.csv"][0].replace("1,0,0,1", "one,0,0,1")))


def test_a_file_that_is_no_text_is_refused(tmp_path: Path):
    with pytest.raises(InvalidFile, match=r"can't read pose log .*poses\.csv.*can't decode byte 0xff"):
        read_pose_log(write(tmp_path, "poses.csv", b"t\xff\xfe"))


def test_a_missing_file_is_refused(tmp_path: Path):
    with pytest.raises(InvalidFile, match=r"no pose log .*nowhere\.csv"):
        read_pose_log(tmp_path / "nowhere.csv")


def test_a_folder_without_trajectories_is_refused(tmp_path: Path):
    with pytest.raises(InvalidFile, match=r"is a folder without \.log, \.txt, \.tum files"):
        read_pose_log(tmp_path)


def test_a_folder_of_tracks_is_refused_because_they_share_no_stamps(tmp_path: Path):
    write(tmp_path, "1.log", "1 2 3\n")
    with pytest.raises(InvalidFile, match=r"1\.log is no TUM trajectory"):
        read_pose_log(tmp_path)
