"""Random sequences of edits: each gives a valid draft or is refused; all are undone, redone, saved and read back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from station.builder import edits, marking, placing
from station.builder.desk import Desk, within
from station.builder.documents import from_text, to_text, to_tree, to_urdf_text
from station.builder.draft import Draft, blank, limits_of
from station.builder.drawing import joint_glyph, part_blocks, part_poses, sliders
from station.errors import InvalidData
from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree_json import from_json, to_json
from station.simulate import SimulationOptions, simulate

NAMES = ("base", "arm", "hand", "lid", "part", "Bad Name", "")
TYPES = (*JOINT_TYPES, "hinge")


@dataclass(frozen=True)
class Nth:
    """One of the parts that are there, so that most edits find one."""

    number: int

    def of(self, draft: Draft) -> str:
        return draft.parts[self.number % len(draft.parts)]


names = st.builds(Nth, st.integers(0, 9)) | st.sampled_from(NAMES)
new_names, types = st.sampled_from(NAMES), st.sampled_from(TYPES)
lengths = st.floats(-2.0, 2.0) | st.sampled_from([0.0, 1e9, float("nan"), float("inf")])
vectors = st.tuples(lengths, lengths, lengths)
quaternions = st.tuples(*[st.floats(-1.0, 1.0)] * 4)
ids = st.integers(0, 3) | st.integers(-1, 51)

Edit = Callable[[Draft, dict[str, float]], Draft]


def above(draft: Draft, part: str) -> str:
    """A joint's name by that of its part, so that most edits of joints find one."""
    joint = next((joint for joint in draft.joints if joint.child == part), None)
    return part if joint is None else joint.name


def edit(*arguments: st.SearchStrategy[object], does: Callable[..., Draft]) -> st.SearchStrategy[Edit]:
    def change(given: tuple[object, ...]) -> Edit:
        return lambda draft, states: does(draft, states, *(x.of(draft) if isinstance(x, Nth) else x for x in given))

    return st.tuples(*arguments).map(change)


EDITS = st.one_of(
    edit(new_names, names, types, does=lambda d, s, *a: edits.add_part(d, *a)),
    edit(names, types, does=lambda d, s, parent, type: edits.add_part(d, None, parent, type)),
    edit(types, does=lambda d, s, type: edits.add_part(d, type=type)),
    edit(names, new_names, does=lambda d, s, *a: edits.rename_part(d, *a)),
    edit(names, new_names, does=lambda d, s, a, b: edits.rename_joint(d, above(d, a), b)),
    edit(names, does=lambda d, s, *a: edits.delete_part(d, *a)),
    edit(names, does=lambda d, s, *a: edits.delete_branch(d, *a)),
    edit(names, names, does=lambda d, s, *a: edits.set_parent(d, *a)),
    edit(names, does=lambda d, s, *a: edits.set_root(d, *a)),
    edit(names, types, does=lambda d, s, a, type: edits.set_type(d, above(d, a), type)),
    edit(names, lengths, lengths, does=lambda d, s, a, *b: edits.set_limits(d, above(d, a), *b)),
    edit(names, lengths, does=lambda d, s, a, b: edits.set_pitch(d, above(d, a), b)),
    edit(names, vectors, vectors, does=lambda d, s, a, *b: placing.set_axis(d, above(d, a), *b)),
    edit(names, quaternions, vectors, does=lambda d, s, a, *b: placing.place_axis(d, above(d, a), *b, s)),
    edit(names, quaternions, vectors, does=lambda d, s, *a: placing.place_part(d, *a, s)),
    edit(names, vectors, vectors, does=lambda d, s, *a: placing.set_zero(d, *a)),
    edit(names, lengths, ids | st.none(), does=lambda d, s, *a: marking.add_marker(d, *a)),
    edit(names, does=lambda d, s, *a: marking.add_marker(d, *a)),
    edit(ids, does=lambda d, s, *a: marking.delete_marker(d, *a)),
    edit(ids, ids, names, does=lambda d, s, a, b, c: marking.change_marker(d, a, new_id=b, part=c)),
    edit(ids, quaternions, vectors, does=lambda d, s, *a: marking.place_marker(d, *a, s)),
    edit(names, vectors, vectors, does=lambda d, s, *a: marking.set_block(d, *a)),
    edit(names, does=lambda d, s, *a: marking.clear_blocks(d, *a)),
)
SEQUENCES = st.lists(EDITS, max_size=25)


def edited(sequence: list[Edit]) -> list[Desk]:
    """The desk after each edit that was not refused; a refusal of any other kind than InvalidData fails."""
    desks = [Desk.of(blank())]
    for change in sequence:
        desk = desks[-1]
        before = to_text(desk.draft)
        try:
            after = desk.edited(change(desk.draft, dict(desk.states)), "an edit")
        except InvalidData:
            assert to_text(desk.draft) == before
            continue
        if after is not desk:
            desks.append(after)
    return desks


@settings(max_examples=60, deadline=None)
@given(SEQUENCES)
def test_what_edits_lead_to_is_a_tree_that_strict_readers_take(sequence: list[Edit]):
    draft = edited(sequence)[-1].draft
    tree = from_json(to_text(draft), "drawn.json")
    assert tree.bodies == draft.parts and len(tree.joints) == len(draft.parts) - 1
    assert all(limits_of(joint)[0] < limits_of(joint)[1] for joint in tree.movable)
    assert to_json(tree) == to_text(draft)


@settings(max_examples=60, deadline=None)
@given(SEQUENCES)
def test_a_saved_draft_is_read_back_as_it_was(sequence: list[Edit]):
    draft = edited(sequence)[-1].draft
    again = from_text(to_text(draft), f"{draft.name}.json")
    assert to_text(again) == to_text(draft) and again.name == draft.name
    for old, new in zip(draft.markers, again.markers, strict=True):
        assert (old.id, old.part, old.size_m) == (new.id, new.part, new.size_m)
        np.testing.assert_array_equal(old.mount, new.mount)
    for old, new in zip(draft.blocks, again.blocks, strict=True):
        assert (old.part, old.colour, old.size_m.tolist()) == (new.part, new.colour, new.size_m.tolist())
        np.testing.assert_array_equal(old.T_part_block, new.T_part_block)
    for old, new in zip(draft.joints, again.joints, strict=True):
        assert (old.name, old.type, old.parent, old.child) == (new.name, new.type, new.parent, new.child)
        assert (old.limits, old.pitch_m_per_rad) == (new.limits, new.pitch_m_per_rad)
        np.testing.assert_array_equal(old.T_parent_child_zero, new.T_parent_child_zero)


@settings(max_examples=40, deadline=None)
@given(SEQUENCES)
def test_a_urdf_moves_as_the_draft_does(sequence: list[Edit]):
    draft = edited(sequence)[-1].draft
    again = from_text(to_urdf_text(draft), "drawn.urdf")
    states = draft.usual_states()
    old, new = draft.poses(states), again.tree.forward(np.array([states[column] for column in again.tree.columns]))
    for part in draft.parts:
        # URDF tells rotations as angles: a digit or two are lost of lengths of up to some thousand metres.
        np.testing.assert_allclose(new[part], old[part], atol=1e-8)


@settings(max_examples=60, deadline=None)
@given(SEQUENCES)
def test_all_edits_can_be_undone_to_nothing_and_done_again(sequence: list[Edit]):
    desks = edited(sequence)
    texts = [to_text(desk.draft) for desk in desks]
    desk = desks[-1]
    for text in reversed(texts[:-1]):
        desk = desk.undone()
        assert to_text(desk.draft) == text
    assert desk.undone() is desk and not desk.unsaved
    for text in texts[1:]:
        desk = desk.redone()
        assert to_text(desk.draft) == text
    assert desk.redone() is desk


@settings(max_examples=40, deadline=None)
@given(SEQUENCES, st.lists(st.floats(-10.0, 10.0), min_size=40, max_size=40))
def test_whatever_is_drawn_can_be_shown_at_any_state(sequence: list[Edit], values: list[float]):
    draft = edited(sequence)[-1].draft
    states = within(draft, dict(zip(draft.tree.columns, values, strict=False)))
    for slider in sliders(draft):
        value = states[slider.column] / slider.per_unit
        # Ends are rounded to six digits for people.
        assert slider.low - 1e-5 <= value <= slider.high + 1e-5
    for part, (wxyz, xyz) in part_poses(draft, states).items():
        assert np.all(np.isfinite([*wxyz, *xyz])) and part_blocks(draft, part)
    for joint in draft.joints:
        assert all(np.all(np.isfinite(line.points_m)) for line in joint_glyph(draft, joint.name, states).lines)


@settings(max_examples=20, deadline=None)
@given(SEQUENCES)
def test_whatever_is_drawn_can_be_simulated(sequence: list[Edit]):
    draft = edited(sequence)[-1].draft
    simulated = simulate(to_tree(draft), SimulationOptions(frames=3), 0)
    assert simulated.log.parts == draft.tree.parts
