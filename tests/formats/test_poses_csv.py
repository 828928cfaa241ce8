"""poses.csv: what is read, what is written, and what is refused with its row."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.errors import InvalidFile
from station.formats.poses_csv import format_poses_csv, parse_poses_csv
from station.kinematics import se3
from station.logs import PoseLog

examples = settings(max_examples=25, deadline=None)  # a loaded machine is no failure
HEADER = "t_s,part,x_m,y_m,z_m,qw,qx,qy,qz\n"
GOOD = HEADER + "0.5,base,1,2,3,1,0,0,0\n0.5,lid,4,5,6,0,0,0,1\n0.75,base,1,2,3.5,1,0,0,0\n"


def random_log(seed: int, *, with_covariance: bool) -> PoseLog:
    """Three parts at five times, one pose in four unseen, part `a` seen first at every start."""
    rng = np.random.default_rng(seed)
    poses = se3.exp(rng.normal(size=(5, 3, 6)) * [1, 1, 1, 2, 2, 2])
    hidden = rng.random((5, 3)) < 0.25
    hidden[:, 0] = hidden[0] = False
    poses[hidden] = np.nan
    t_s = np.cumsum(rng.uniform(1e-3, 1, 5))
    covariance = None
    if with_covariance:
        covariance = np.zeros((5, 3, 6, 6))
        std = rng.uniform(1e-4, 1e-2, (5, 3, 2)).repeat(3, axis=-1)
        covariance[..., np.arange(6), np.arange(6)] = std**2
        covariance[hidden] = np.nan
    return PoseLog(t_s, "world", ("a", "b", "c"), poses, covariance)


def test_rows_become_times_and_parts():
    log = parse_poses_csv(GOOD, "poses.csv")
    assert (log.reference, log.parts, log.covariance) == ("world", ("base", "lid"), None)
    np.testing.assert_array_equal(log.t_s, [0.5, 0.75])
    np.testing.assert_array_equal(log.seen, [[True, True], [True, False]])
    np.testing.assert_array_equal(log.T_ref_part[1, 0], se3.translation([1, 2, 3.5]))
    np.testing.assert_allclose(log.T_ref_part[0, 1], se3.translation([4, 5, 6]) @ np.diag([-1, -1, 1, 1]), atol=1e-15)


def test_the_reference_is_what_the_caller_says():
    assert parse_poses_csv(GOOD, "poses.csv", reference="camera").reference == "camera"


def test_columns_are_known_by_their_names_blanks_and_empty_lines_are_nothing():
    text = "\ufeff\n part , t_s,x_m,y_m,z_m,qw,qx,qy,qz\r\n\r\n lid ,0.5, 4,5,6,0,0,0,1\r\n"
    log = parse_poses_csv(text, "poses.csv")
    np.testing.assert_array_equal(log.T_ref_part[0, 0, :3, 3], [4, 5, 6])


@given(st.integers(0, 2**32 - 1), st.booleans())
@examples
def test_a_log_reads_back_as_it_was(seed: int, with_covariance: bool):
    log = random_log(seed, with_covariance=with_covariance)
    again = parse_poses_csv(format_poses_csv(log), "poses.csv")
    np.testing.assert_array_equal(again.t_s, log.t_s)
    assert again.parts == log.parts
    np.testing.assert_array_equal(again.seen, log.seen)
    np.testing.assert_array_equal(again.T_ref_part[..., :3, 3], log.T_ref_part[..., :3, 3])
    np.testing.assert_allclose(again.T_ref_part, log.T_ref_part, atol=1e-14)
    if with_covariance:
        np.testing.assert_allclose(again.covariance, log.covariance, rtol=1e-12)
    else:
        assert again.covariance is None


def test_a_position_without_a_rotation_has_infinite_rotation_variance():
    log = parse_poses_csv(HEADER + "0,base,1,2,3,1,0,0,0\n0,lid,4,5,6,,,,\n", "poses.csv")
    np.testing.assert_array_equal(log.T_ref_part[0, 1], se3.translation([4, 5, 6]))
    variances = np.diagonal(log.covariance[0], axis1=-2, axis2=-1)
    np.testing.assert_array_equal(variances, [[np.nan] * 6, [np.nan] * 3 + [np.inf] * 3])


def test_positions_without_rotations_are_written_as_blanks():
    text = HEADER + "0.0,base,1.0,2.0,3.0,1.0,0.0,0.0,0.0\n0.0,lid,4.0,5.0,6.0,,,,\n"
    assert format_poses_csv(parse_poses_csv(text, "poses.csv")) == text


def test_deviations_are_per_axis_and_blank_where_unknown():
    text = HEADER[:-1] + ",std_m,std_rad\n0.0,base,1.0,2.0,3.0,1.0,0.0,0.0,0.0,0.5,0.25\n"
    text += "0.0,lid,4.0,5.0,6.0,1.0,0.0,0.0,0.0,,\n0.0,knob,4.0,5.0,6.0,,,,,0.125,\n"
    log = parse_poses_csv(text, "poses.csv")
    np.testing.assert_array_equal(log.covariance[0, 0], np.diag([0.25] * 3 + [0.0625] * 3))
    assert np.isnan(np.diagonal(log.covariance[0, 1])).all()
    np.testing.assert_array_equal(np.diagonal(log.covariance[0, 2]), [0.125**2] * 3 + [np.inf] * 3)
    assert format_poses_csv(log) == text


def test_a_covariance_is_written_as_its_mean_over_the_axes():
    covariance = np.diag([1.0, 4.0, 4.0, 9.0, 9.0, 9.0])[None, None]
    text = format_poses_csv(PoseLog([0.0], "world", ("a",), se3.identity(1, 1), covariance))
    assert [float(x) for x in text.splitlines()[1].split(",")[-2:]] == pytest.approx([np.sqrt(3), 3])


def test_a_quaternion_within_a_thousandth_of_unit_length_is_normalised():
    log = parse_poses_csv(HEADER + "0,base,1,2,3,0.9991,0,0,0\n", "poses.csv")
    np.testing.assert_array_equal(log.T_ref_part[0, 0, :3, :3], np.eye(3))


@pytest.mark.parametrize(
    ("rows", "message"),
    (
        ("0,base,nan,2,3,1,0,0,0", "row 2: x_m is 'nan'; want a finite number"),
        ("0,base,1,2,3,1,0,0,0\n\n0,lid,1,inf,3,1,0,0,0", "row 4: y_m is 'inf'"),
        ("0,base,1,2,3,NaN,0,0,0", "row 2: qw is 'NaN'"),
        ("0,base,1,,3,1,0,0,0", "row 2: y_m is blank; want a number"),
        ("0,base,1,two,3,1,0,0,0", "row 2: y_m is 'two'; want a number"),
        (",base,1,2,3,1,0,0,0", "row 2: t_s is blank"),
        (
            "1,base,1,2,3,1,0,0,0\n0.5,base,1,2,3,1,0,0,0",
            "row 3: t_s 0.5 follows 1; want rows in which times never fall",
        ),
        (
            "1,base,1,2,3,1,0,0,0\n1,lid,1,2,3,1,0,0,0\n1,base,1,2,3,1,0,0,0",
            "row 4: part 'base' is there twice at t = 1 s",
        ),
        ("0,base,1,2,3,1.0011,0,0,0", r"row 2: quaternion of length 1.0011; want 1 within 0.001"),
        ("0,base,1,2,3,0,0,0,0", "row 2: quaternion of length 0"),
        ("0,base,1,2,3,1,0,0,", "row 2: part of the quaternion is blank"),
        ("0,Base,1,2,3,1,0,0,0", "row 2: 'Base' is no part's name"),
        ("0,,1,2,3,1,0,0,0", "row 2: '' is no part's name"),
        ("0,base,1,2,3,1,0,0", "row 2: 8 cells; want 9"),
        ("", "no data below its header"),
    ),
)
def test_a_bad_row_is_refused_with_its_number(rows: str, message: str):
    with pytest.raises(InvalidFile, match="poses.csv.*" + message):
        parse_poses_csv(HEADER + rows + "\n", "poses.csv")


@pytest.mark.parametrize(
    ("text", "message"),
    (
        ("", "poses.csv is empty"),
        ("t_s,part,x_m\n0,base,1\n", "no column y_m, z_m, qw, qx, qy, qz"),
        (HEADER[:-1] + ",mood\n0,base,1,2,3,1,0,0,0,1\n", "unknown column mood"),
        (GOOD.replace("t_s", "part", 1), "row 1: column 'part' is there twice"),
        (GOOD.replace("t_s", "", 1), "row 1: column 1 has no name"),
        (HEADER[:-1] + ",std_m\n0,base,1,2,3,1,0,0,0,1\n", "both of the columns std_m and std_rad, or neither"),
        (HEADER[:-1] + ",std_m,std_rad\n0,base,1,2,3,1,0,0,0,0,1\n", "row 2: std_m is 0; want more than 0"),
        (HEADER[:-1] + ",std_m,std_rad\n0,base,1,2,3,,,,,1,1\n", "row 2: std_rad of a row without a quaternion"),
    ),
)
def test_a_bad_table_is_refused(text: str, message: str):
    with pytest.raises(InvalidFile, match=message):
        parse_poses_csv(text, "poses.csv")
