"""The desk: what can be undone, what counts as saved, and where sliders may stand."""

from __future__ import annotations

import numpy as np
import pytest

from station.builder.desk import MOST_STEPS, Desk
from station.builder.documents import to_text
from station.builder.draft import blank
from station.builder.edits import add_part, delete_part, rename_part, set_limits, set_type
from station.builder.placing import set_zero
from station.errors import InvalidData


def door() -> Desk:
    return Desk.of(add_part(blank(), "door"))


def test_an_edit_counts_as_unsaved_until_it_is_saved_or_undone():
    desk = door()
    assert not desk.unsaved
    changed = desk.edited(rename_part(desk.draft, "door", "lid"), "rename door")
    assert changed.unsaved and not changed.kept().unsaved
    assert not changed.undone().unsaved
    assert changed.kept().undone().unsaved


def test_an_edit_that_changes_nothing_leaves_nothing_to_undo():
    desk = door()
    assert desk.edited(rename_part(desk.draft, "door", "door"), "rename door") is desk


def test_the_buttons_say_what_they_undo_and_redo():
    desk = door()
    assert desk.undo_what is None and desk.redo_what is None
    desk = desk.edited(delete_part(desk.draft, "door"), "delete door")
    assert desk.undo_what == "delete door"
    assert desk.undone().redo_what == "delete door" and desk.undone().undo_what is None


def test_a_drag_is_undone_at_once_and_the_next_drag_by_itself():
    desk = door()
    start = to_text(desk.draft)
    for x in (0.1, 0.2, 0.3):
        desk = desk.edited(set_zero(desk.draft, "door", (x, 0, 0), (0, 0, 0)), "move door", gesture="drag 1")
    middle = to_text(desk.draft)
    desk = desk.edited(set_zero(desk.draft, "door", (0.4, 0, 0), (0, 0, 0)), "move door", gesture="drag 2")
    assert to_text(desk.undone().draft) == middle
    assert to_text(desk.undone().undone().draft) == start


def test_a_new_edit_forgets_what_was_undone():
    desk = door()
    undone = desk.edited(delete_part(desk.draft, "door"), "delete door").undone()
    assert undone.edited(add_part(undone.draft, "lid"), "add lid").redo_what is None


def test_no_more_steps_are_kept_than_the_most():
    desk = door()
    for k in range(MOST_STEPS + 50):
        desk = desk.edited(set_limits(desk.draft, "door_joint", -1.0, 1.0 + k), "limits")
    assert len(desk.past) == MOST_STEPS


def test_sliders_keep_to_the_limits_also_when_these_change():
    desk = door().moved("door_joint", 9.0)
    assert desk.states == {"door_joint": pytest.approx(np.pi / 3)}
    desk = desk.edited(set_limits(desk.draft, "door_joint", 0.2, 0.5), "limits")
    assert desk.states == {"door_joint": 0.5}
    assert desk.rested().states == {"door_joint": 0.2}
    assert desk.undone().states == {"door_joint": 0.5}


def test_moving_a_slider_is_no_edit():
    desk = door()
    assert not desk.moved("door_joint", 0.3).unsaved and desk.moved("door_joint", 0.3).past == ()


def test_a_ball_is_turned_no_further_than_its_limit():
    desk = Desk.of(set_type(door().draft, "door_joint", "spherical"))
    for axis in "xyz":
        desk = desk.moved(f"door_joint_{axis}", 3.0)
    assert np.linalg.norm(list(desk.states.values())) == pytest.approx(np.pi / 4)


@pytest.mark.parametrize(
    ("column", "value", "said"), [("knob", 0.0, "have door_joint"), ("door_joint", np.nan, "want a number")]
)
def test_a_slider_that_is_none_or_stands_nowhere_is_refused(column: str, value: float, said: str):
    with pytest.raises(InvalidData, match=said):
        door().moved(column, value)
