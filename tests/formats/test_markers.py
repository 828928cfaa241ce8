import numpy as np
import pytest

from station.errors import InvalidFile
from station.formats.markers import format_markers, parse_markers
from station.kinematics import se3
from station.perception.markers import Marker, MarkerTable

NAME = "markers.toml"
GOOD = """schema = "markers/1"
dictionary = "DICT_4X4_50"

[[marker]]
id = 3
part = "base"
size_mm = 50.8

[[marker]]
id = 7
part = "link1"
size_mm = 40
T_part_marker = [[0, -1, 0, 0.01], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


def test_millimetres_become_metres_and_mounts_poses() -> None:
    table = parse_markers(GOOD, NAME)
    assert table.parts == ("base", "link1")
    assert [m.size_m for m in table.markers] == pytest.approx([0.0508, 0.04])
    assert table.markers[0].T_part_marker is None
    np.testing.assert_array_equal(table.markers[1].mount[:3, 3], [0.01, 0, 0])


def test_a_table_reads_back_the_same() -> None:
    mount = se3.exp(np.array([0.01, 0.02, 1 / 3, 0.3, -0.2, 0.9]))
    table = MarkerTable("DICT_5X5_100", (Marker(0, "a", 0.0508, mount), Marker(99, "a", 1 / 30, np.eye(4))))
    again = parse_markers(format_markers(table), NAME)
    assert (again.dictionary, again.parts) == (table.dictionary, table.parts)
    for new, old in zip(again.markers, table.markers, strict=True):
        assert (new.id, new.part) == (old.id, old.part)
        assert new.size_m == pytest.approx(old.size_m, rel=1e-14)
        np.testing.assert_array_equal(new.mount, old.mount)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("id = 3", "id = 3\nidd = 4", "marker 1, idd: unknown key; known here: id, part, size_mm, T_part_marker"),
        ("dictionary =", "dict = 1\ndictionary =", "dict: unknown key; known here: dictionary, marker"),
        ("id = 3", "id = 3.0", "marker 1, id: input should be a valid integer; have 3.0"),
        ("id = 3", "id = true", "marker 1, id: input should be a valid integer; have True"),
        ("50.8", '"50.8"', "marker 1, size_mm: input should be a valid number; have '50.8'"),
        ("50.8", "0.0", "marker 3: size is 0 m; want the side of the black square, above 0"),
        ("id = 7", "id = 3", "marker ids twice in the table: 3"),
        ("id = 7", "id = 50", "marker 50 is not in DICT_4X4_50; its ids are 0 to 49"),
        ("id = 7", "id = -1", "marker -1: id must be a whole number of at least 0"),
        ("4X4_50", "4X4_49", "no marker dictionary 'DICT_4X4_49'; want one of"),
        ('"link1"', '"Link 1"', "'Link 1' is no name"),
        ('"link1"', '"base"', "part 'base' has 2 markers, but marker 3 has no mount"),
        ("[0, 0, 1, 0]", "[0, 0, 2, 0]", "marker 7: T_part_marker is no rigid motion"),
        ("[0, 0, 1, 0]", "[0, 0, 1]", "marker 2, T_part_marker 3: list should have at least 4 items"),
        ("markers/1", "markers/9", "has schema 'markers/9'; this station reads 'markers/1'"),
        ("[[marker]]", "[marker]", "is no TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_its_name_the_key_and_the_wish(old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(InvalidFile, match=message) as caught:
        parse_markers(GOOD.replace(old, new, 1), NAME)
    assert str(caught.value).startswith(NAME)
    assert len(str(caught.value).splitlines()) <= 5


def test_a_table_without_markers_is_refused() -> None:
    with pytest.raises(InvalidFile, match="the marker table is empty"):
        parse_markers('schema = "markers/1"\ndictionary = "DICT_4X4_50"\nmarker = []\n', NAME)
