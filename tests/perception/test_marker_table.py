import numpy as np
import pytest

from station.errors import InvalidData
from station.perception.markers import DICTIONARY_SIZES, Marker, MarkerTable, load_dictionary


@pytest.mark.parametrize("name", DICTIONARY_SIZES)
def test_the_dictionaries_are_opencvs(name: str) -> None:
    assert len(load_dictionary(name).bytesList) == DICTIONARY_SIZES[name]


def test_rows_and_sizes_of_unknown_ids_say_so() -> None:
    table = MarkerTable("DICT_4X4_50", (Marker(7, "a", 0.05), Marker(2, "b", 0.04)))
    ids = np.array([[2, 7], [3, 49], [50, -1]])
    np.testing.assert_array_equal(table.rows(ids), [[1, 0], [-1, -1], [-1, -1]])
    np.testing.assert_array_equal(table.sizes_m(ids), [[0.04, 0.05], [np.nan, np.nan], [np.nan, np.nan]])


def test_parts_keep_the_order_of_their_first_appearance() -> None:
    mount = np.eye(4)
    markers = (Marker(1, "b", 0.05, mount), Marker(0, "a", 0.05), Marker(2, "b", 0.05, mount))
    assert MarkerTable("DICT_4X4_50", markers).parts == ("b", "a")


def test_a_mount_is_frozen() -> None:
    marker = Marker(1, "b", 0.05, np.eye(4))
    with pytest.raises(ValueError, match="read-only"):
        marker.mount[0, 0] = 2.0


def test_a_mount_that_mirrors_is_refused() -> None:
    with pytest.raises(InvalidData, match="no rigid motion"):
        Marker(1, "b", 0.05, np.diag([1.0, 1.0, -1.0, 1.0]))
