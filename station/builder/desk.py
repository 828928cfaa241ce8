"""What the builder holds: the draft, what it was and may become again, the sliders' states, and what is saved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from station.builder.documents import to_text
from station.builder.draft import Draft, limits_of
from station.errors import InvalidData

# Steps that can be undone; older ones are forgotten.
MOST_STEPS = 200


@dataclass(frozen=True, eq=False, slots=True)
class Step:
    """A draft as it was, and what was done to it then."""

    draft: Draft
    what: str
    gesture: str | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Desk:
    """All that a page shows and changes; every change is a new one.

    Attributes:
        draft: as it is now.
        states: of the sliders, by column [rad or m]; within the limits of the draft.
        past: steps that can be undone, the latest last.
        future: steps that can be redone, the next one last.
        saved: text of the draft as it was last saved or opened; None if it never was.
    """

    draft: Draft
    states: Mapping[str, float]
    past: tuple[Step, ...] = ()
    future: tuple[Step, ...] = ()
    saved: str | None = None

    @staticmethod
    def of(draft: Draft) -> Desk:
        """A desk with a draft on it that has just been opened."""
        return Desk(draft, draft.usual_states(), saved=to_text(draft))

    @property
    def unsaved(self) -> bool:
        """Whether the draft is another than the one last saved or opened."""
        return to_text(self.draft) != self.saved

    @property
    def undo_what(self) -> str | None:
        """What `undone` would take back; None if there is nothing."""
        return self.past[-1].what if self.past else None

    @property
    def redo_what(self) -> str | None:
        """What `redone` would do again; None if there is nothing."""
        return self.future[-1].what if self.future else None

    def edited(self, draft: Draft, what: str, *, gesture: str | None = None) -> Desk:
        """The desk after an edit.

        Args:
            draft: that the edit gave; if it is the one that lies here, nothing has happened.
            what: was done, in words for the undo button.
            gesture: of what the edit is a part, such as one drag of a gizmo: edits of the same gesture in a row are
                undone at once.
        """
        if draft is self.draft:
            return self
        goes_on = gesture is not None and bool(self.past) and self.past[-1].gesture == gesture
        past = self.past if goes_on else (*self.past, Step(self.draft, what, gesture))
        return replace(self._showing(draft), past=past[-MOST_STEPS:], future=())

    def undone(self) -> Desk:
        """The desk before the last edit; itself if there was none."""
        if not self.past:
            return self
        step = self.past[-1]
        back = Step(self.draft, step.what)
        return replace(self._showing(step.draft), past=self.past[:-1], future=(*self.future, back))

    def redone(self) -> Desk:
        """The desk after the edit that was undone last; itself if there is none."""
        if not self.future:
            return self
        step = self.future[-1]
        back = Step(self.draft, step.what)
        return replace(self._showing(step.draft), past=(*self.past, back), future=self.future[:-1])

    def kept(self) -> Desk:
        """The desk after the draft was saved."""
        return replace(self, saved=to_text(self.draft))

    def moved(self, column: str, value: float) -> Desk:
        """The desk with another state [rad or m] of a slider, within its limits; no step that is undone.

        Raises:
            InvalidData: for a column that isn't there, and what is no number.
        """
        if column not in self.states:
            raise InvalidData(f"nothing moves by '{column}'; have {', '.join(self.states) or 'nothing that moves'}")
        if not np.isfinite(value):
            raise InvalidData(f"'{column}' can't be {value}; want a number")
        return replace(self, states=within(self.draft, {**self.states, column: float(value)}))

    def posed(self, states: Mapping[str, float]) -> Desk:
        """The desk with other states of several sliders, within their limits; those of unknown columns are ignored."""
        return replace(self, states=within(self.draft, {**self.states, **states}))

    def rested(self) -> Desk:
        """The desk with all sliders as near to 0 as their limits allow."""
        return replace(self, states=self.draft.usual_states())

    def _showing(self, draft: Draft) -> Desk:
        return replace(self, draft=draft, states=within(draft, self.states))


def within(draft: Draft, states: Mapping[str, float]) -> dict[str, float]:
    """A state for each of the draft's columns [rad or m]: those given, within limits, as usual where none is given.

    A rotation vector that is longer than a ball's limit is shortened to it; one that is shorter than its least angle
    stays, since no direction could be told for a lengthened zero.
    """
    found = draft.usual_states()
    for joint in draft.tree.movable:
        low, high = limits_of(joint)
        given = np.array([states.get(column, found[column]) for column in joint.columns])
        if joint.type == "spherical":
            given = given * min(1.0, high / max(float(np.linalg.norm(given)), high))
        else:
            given = np.clip(given, low, high)
        found.update(zip(joint.columns, given.tolist(), strict=True))
    return found
