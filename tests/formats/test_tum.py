"""TUM trajectories, one and several."""

import numpy as np
import pytest

from station.errors import InvalidFile
from station.formats.tum import parse_tum, parse_tum_files
from station.kinematics import se3

LID = "# timestamp tx ty tz qx qy qz qw\n1305031102.1753 1 2 3 0 0 0 1\n1305031102.2753 4 5 6 0 0 1 0\n"


def test_a_trajectory_is_one_part_with_its_own_stamps():
    log = parse_tum(LID, "lid.txt")
    assert (log.reference, log.parts, log.covariance) == ("world", ("lid",), None)
    np.testing.assert_array_equal(log.t_s, [1305031102.1753, 1305031102.2753])
    np.testing.assert_allclose(log.T_ref_part[1, 0], se3.translation([4, 5, 6]) @ np.diag([-1, -1, 1, 1]), atol=1e-15)


def test_several_trajectories_share_the_union_of_their_stamps():
    log = parse_tum_files(
        {"b.txt": "0 1 0 0 0 0 0 1\n2 3 0 0 0 0 0 1\n", "a.txt": "1 7 0 0 0 0 0 1\n2 8 0 0 0 0 0 1\n"}, "run"
    )
    assert log.parts == ("b", "a")
    np.testing.assert_array_equal(log.t_s, [0, 1, 2])
    np.testing.assert_array_equal(log.T_ref_part[..., 0, 3], [[1, np.nan], [np.nan, 7], [3, 8]])


def test_two_files_of_one_part_are_refused():
    row = "0 1 0 0 0 0 0 1\n"
    with pytest.raises(InvalidFile, match="run: more than one file names the part lid"):
        parse_tum_files({"lid.txt": row, "Lid.txt": row}, "run")


@pytest.mark.parametrize(
    ("text", "message"),
    (
        ("", "lid.txt has no data; want rows of 8 numbers"),
        ("0 1 0 0 0 0 1\n", "row 1: 7 numbers; want 8 numbers"),
        ("0 1 0 0 0 0 0 1\n0 1 0 0 0 0 0 1\n", "row 2: t 0 follows 0; want rows in which times increase"),
        ("0 1 0 0 0 0 0 0.9\n", "row 1: quaternion of length 0.9"),
    ),
)
def test_a_bad_row_is_refused_with_its_number(text: str, message: str):
    with pytest.raises(InvalidFile, match=message):
        parse_tum(text, "lid.txt")
