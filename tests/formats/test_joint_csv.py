"""joint_states.csv and commands.csv."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from station.errors import InvalidData, InvalidFile
from station.formats.joint_csv import format_joint_states, parse_commands, parse_joint_states
from station.logs import JointLog

examples = settings(max_examples=50, deadline=None)  # a loaded machine is no failure
numbers = st.floats(allow_infinity=False, allow_nan=True)


@given(arrays(np.float64, (4, 2), elements=numbers), arrays(np.float64, (4, 2), elements=numbers))
@examples
def test_states_read_back_to_the_last_bit(q: np.ndarray, std: np.ndarray):
    t_s = np.array([0.1, np.nextafter(0.1, 1), 1 / 3, 1305031102.1753001])
    log = JointLog(t_s, ("pan", "slide"), q, ("rad", "m"), np.abs(std))
    again = parse_joint_states(format_joint_states(log), "joint_states.csv", {"pan": "rad", "slide": "m"})
    assert (again.joints, again.units) == (log.joints, log.units)
    np.testing.assert_array_equal(again.t_s, t_s)
    np.testing.assert_array_equal(again.q, log.q)
    np.testing.assert_array_equal(again.std, log.std)


def test_the_deviations_come_after_the_states_and_unseen_cells_are_blank():
    log = JointLog([0.0, 0.1], ("pan", "lift"), [[1.5, np.nan], [2.0, 3.0]], ("rad",) * 2, [[0.1, np.nan], [0.2, 0.3]])
    assert format_joint_states(log) == "t_s,pan,lift,pan_std,lift_std\n0.0,1.5,,0.1,\n0.1,2.0,3.0,0.2,0.3\n"


def test_states_that_are_no_estimates_have_no_deviations():
    log = JointLog([0.0], ("pan",), [[1.5]], ("rad",))
    assert format_joint_states(log) == "t_s,pan\n0.0,1.5\n"
    assert parse_joint_states(format_joint_states(log), "x.csv").std is None


def test_a_joint_named_like_a_deviation_is_refused():
    with pytest.raises(InvalidData, match="joint 'pan_std' is named like"):
        format_joint_states(JointLog([0.0], ("pan", "pan_std"), [[1.0, 2.0]], ("rad",) * 2))


def test_commands_are_radians_unless_told():
    text = "t_s,pan,lift\n0,0.5,\n1,,0.2\n"
    log = parse_commands(text, "commands.csv", {"lift": "m"})
    assert (log.joints, log.units, log.std) == (("pan", "lift"), ("rad", "m"), None)
    np.testing.assert_array_equal(log.q, [[0.5, np.nan], [np.nan, 0.2]])
    assert parse_commands(text, "commands.csv").units == ("rad", "rad")


def test_every_column_of_commands_is_a_joint():
    assert parse_commands("t_s,pan,pan_std\n0,1,2\n", "commands.csv").joints == ("pan", "pan_std")


@pytest.mark.parametrize("parse", (parse_commands, parse_joint_states))
@pytest.mark.parametrize(
    ("text", "message"),
    (
        ("", "is empty"),
        ("t_s,pan\n", "no data"),
        ("time,pan\n0,1\n", "columns time,pan; want t_s, then a column for each joint"),
        ("t_s,Pan 1\n0,1\n", "column 'Pan 1' is no joint's name"),
        ("t_s,pan\n0,1\n2,1\n1,1\n", "row 4: t_s 1 follows 2; want rows in which times increase"),
        ("t_s,pan\n0,1\n0,1\n", "row 3: t_s 0 follows 0"),
        ("t_s,pan\n0,1\n,1\n", "row 3: t_s is blank"),
        ("t_s,pan\n0,nan\n", "row 2: pan is 'nan'"),
        ("t_s,pan\n0,1,2\n", "row 2: 3 cells; want 2"),
    ),
)
def test_a_bad_row_is_refused_with_its_number(parse, text: str, message: str):
    with pytest.raises(InvalidFile, match="joints.csv.*" + message):
        parse(text, "joints.csv")


def test_the_states_of_a_tree_without_joints_are_its_times():
    log = JointLog([0.0, 0.5], (), np.zeros((2, 0)), ())
    again = parse_joint_states(format_joint_states(log), "joint_states.csv")
    assert again.joints == () and again.t_s.tolist() == [0.0, 0.5]
    with pytest.raises(InvalidFile, match="columns t_s; want t_s, then a column for each joint"):
        parse_commands("t_s\n0\n", "commands.csv")


def test_a_deviation_below_zero_is_refused_with_its_row():
    with pytest.raises(InvalidFile, match="row 3: pan_std is -0\\.1; want 0 or more"):
        parse_joint_states("t_s,pan,pan_std\n0,1,0.1\n1,1,-0.1\n", "joints.csv")


def test_a_unit_that_is_none_is_refused():
    with pytest.raises(InvalidData, match="want one of rad, m"):
        parse_commands("t_s,pan\n0,1\n", "commands.csv", {"pan": "deg"})
