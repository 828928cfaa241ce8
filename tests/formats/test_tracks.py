"""Plain track logs, with and without orientation."""

import numpy as np
import pytest

from station.errors import InvalidFile
from station.formats.tracks import parse_track
from station.kinematics import se3

DOOR = """# a door
-0.04 -0.15 0.90 0.0 0.0 0.6 0.8

-0.03 -0.15 0.91 0.0 0.0 0.0 1.0
"""


def test_a_track_with_orientation_is_one_part_in_the_world():
    log = parse_track(DOOR, "Door 7.log")
    assert (log.reference, log.parts, log.covariance) == ("world", ("door_7",), None)
    turn = se3.exp_so3([0, 0, 2 * np.arctan2(0.6, 0.8)])
    np.testing.assert_allclose(log.T_ref_part[0, 0], se3.pose(turn, [-0.04, -0.15, 0.90]), atol=1e-15)


def test_rows_of_data_count_the_time_from_zero():
    np.testing.assert_array_equal(parse_track(DOOR, "door.log").t_s, [0.0, 1.0])


def test_a_track_of_positions_has_infinite_rotation_variance_and_an_unknown_one_of_positions():
    log = parse_track("1 2 3\n4 5 6\n", "slide.log")
    np.testing.assert_array_equal(log.T_ref_part[1, 0], se3.translation([4, 5, 6]))
    variances = np.diagonal(log.covariance[1, 0])
    np.testing.assert_array_equal(variances, [np.nan] * 3 + [np.inf] * 3)


@pytest.mark.parametrize(
    ("name", "part"),
    (
        ("M2U00389.log", "m2u00389"),
        ("001.log", "track_001"),
        ("folder/Left Door-2.b.log", "left_door_2_b"),
        ("_x.txt", "track__x"),
        ("Tür.log", "t_r"),
    ),
)
def test_the_stem_names_the_part(name: str, part: str):
    assert parse_track("1 2 3\n", name).parts == (part,)


def test_rounded_quaternions_are_normalised():
    log = parse_track("0 0 0 0.112271 0.346605 0.021878 0.931011\n", "x.log")
    R = log.T_ref_part[0, 0, :3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    (
        ("", "x.log has no data"),
        ("# nothing\n", "x.log has no data"),
        ("1 2 3 4\n", r"row 1: 4 numbers; want 3 numbers \(x y z\) or 7 numbers"),
        ("\n1 2 3\n1 2 3 0 0 0 1\n", "row 3: 7 cells; want 3"),
        ("1 2 3\n1 2 nan\n", "row 2: z is 'nan'; want a finite number"),
        ("1 2 3\n1 2 three\n", "row 2: z is 'three'; want a number"),
        ("1 2 3 0 0 0 1\n# why\n1 2 3 0 0 0 1.002\n", "row 3: quaternion of length 1.002"),
    ),
)
def test_a_bad_row_is_refused_with_its_number(text: str, message: str):
    with pytest.raises(InvalidFile, match=message):
        parse_track(text, "x.log")
