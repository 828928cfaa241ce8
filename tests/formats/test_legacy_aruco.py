"""Rows of the ArUco library of 2013 and equation 26."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from station.errors import InvalidFile
from station.formats.legacy_aruco import parse_legacy_aruco, rotation_of_angles

examples = settings(max_examples=50, deadline=None)  # a loaded machine is no failure
HEADER = "t_s,id,tx,ty,tz,rx,ry,rz\n"
angles = st.floats(-4, 4)


@given(angles, angles, angles)
@examples
def test_angles_are_converted_by_equation_26_as_printed(rx: float, ry: float, rz: float):
    def factor(axis: str, angle: float) -> Rotation:
        return Rotation.from_euler(axis, angle)

    expected = factor("z", np.pi / 2) * factor("y", rx) * factor("z", -np.pi / 2) * factor("y", ry) * factor("z", rz)
    np.testing.assert_allclose(rotation_of_angles(np.array([rx, ry, rz])), expected.as_matrix(), atol=1e-14)


@given(angles)
@examples
def test_the_first_three_factors_are_a_turn_about_x_with_the_sign_turned(rx: float):
    expected = Rotation.from_euler("x", -rx).as_matrix()
    np.testing.assert_allclose(rotation_of_angles(np.array([rx, 0, 0])), expected, atol=1e-14)


def test_rows_become_markers_in_the_camera():
    text = HEADER + "0.1,7,0.1,0.2,0.9,0,0,0\n0.1,3,0.3,0.2,0.9,0,0,1.5\n0.2,3,0.3,0.2,0.8,0,0,1.5\n"
    log = parse_legacy_aruco(text, "markers.csv")
    assert (log.reference, log.parts, log.covariance) == ("camera", ("marker_7", "marker_3"), None)
    np.testing.assert_array_equal(log.seen, [[True, True], [False, True]])
    np.testing.assert_array_equal(log.T_ref_part[1, 1, :3, 3], [0.3, 0.2, 0.8])
    np.testing.assert_allclose(log.T_ref_part[1, 1, :3, :3], Rotation.from_euler("z", 1.5).as_matrix(), atol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    (
        ("t_s,id,tx,ty,tz\n0,1,2,3,4\n", "columns t_s,id,tx,ty,tz; want t_s,id,tx,ty,tz,rx,ry,rz"),
        (HEADER + "0,1.5,0,0,1,0,0,0\n", "row 2: id is 1.5; want a whole number"),
        (HEADER + "0,-1,0,0,1,0,0,0\n", "row 2: id is -1; want a whole number"),
        (HEADER + "0,1,0,0,1,0,0,0\n0,1,0,0,1,0,0,0\n", "row 3: part 'marker_1' is there twice"),
        (HEADER + "1,1,0,0,1,0,0,0\n0,1,0,0,1,0,0,0\n", "row 3: t_s 0 follows 1"),
        (HEADER + "0,1,0,0,,0,0,0\n", "row 2: tz is blank"),
    ),
)
def test_a_bad_row_is_refused_with_its_number(text: str, message: str):
    with pytest.raises(InvalidFile, match="markers.csv.*" + message):
        parse_legacy_aruco(text, "markers.csv")
