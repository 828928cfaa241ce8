"""Simulate a draft, fit what was seen, and hold the found tree against the drawn one: in words, rows and lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from station.builder.draft import Draft
from station.builder.drawing import AXIS_M, Line, arrow
from station.builder.playing import TrialSettings
from station.errors import InvalidData
from station.fit import fit
from station.fit.result import Fit
from station.kinematics import se3
from station.kinematics.tree import Joint
from station.logs import FloatArray
from station.simulate import Simulated, simulate
from station.tree_scores import JointScore, TreeScores, score_tree

FOUND_COLOUR = "#e377c2"
HEADER = ("joint", "drawn", "found", "axis off by", "point off by", "states off by")
NOTHING = "-"
# Degrees or millimetres: smaller ones are told as less than this.
LEAST_TOLD = 0.005


@dataclass(frozen=True, slots=True)
class TrialRow:
    """What became of one drawn joint, as texts with units; "-" where there is nothing to tell.

    Attributes:
        true, true_type: name and type of the drawn joint.
        found: name of the found one.
        found_type: its type; "rigid" where both parts were taken for one body.
        axis, point: how far off, and the fit's own standard deviation of it where it has one.
        states: root mean square of the difference of the states, their constant offset taken off.
        right: whether it has the right type between the right bodies.
    """

    true: str
    true_type: str
    found: str
    found_type: str
    axis: str
    point: str
    states: str
    right: bool

    @property
    def cells(self) -> tuple[str, ...]:
        """The row under HEADER."""
        return (self.true, self.true_type, self.found_type, self.axis, self.point, self.states)


@dataclass(frozen=True, eq=False, slots=True)
class Trial:
    """A draft that was simulated and fitted.

    Attributes:
        draft: as it was then.
        settings: of simulation and fit.
        simulated: what was seen, and the truth.
        fit: what was found.
        scores: the found tree against the true one.
    """

    draft: Draft
    settings: TrialSettings
    simulated: Simulated
    fit: Fit
    scores: TreeScores

    @property
    def headline(self) -> str:
        """One sentence: what was found, or what went wrong."""
        joints = self.scores.joints
        count = f"{len(joints)} joint{'' if len(joints) == 1 else 's'}"
        if self.scores.types_correct:
            return f"Found: all bodies, {count} between the right ones, all of the right type{self._worst()}."
        right = sum(score.found_type == score.true_type for score in joints)
        mistakes = "; ".join(self.scores.mistakes)
        return f"Not found: {right} of {count} are right. {mistakes[:1].upper()}{mistakes[1:]}."

    @property
    def rows(self) -> tuple[TrialRow, ...]:
        """A row for each drawn joint that moves."""
        return tuple(_row(score, self._found(score)) for score in self.scores.joints)

    def markdown(self) -> str:
        """The headline, the rows as a table, and the fit's warnings."""
        rules = ("---",) * len(HEADER)
        table = "\n".join(f"| {' | '.join(cells)} |" for cells in (HEADER, rules, *(row.cells for row in self.rows)))
        warnings = "\n".join(f"- {warning}" for warning in self.fit.tree.warnings)
        return "\n\n".join(text for text in (self.headline, table, warnings) if text)

    def found_lines(self, states: Mapping[str, float]) -> tuple[Line, ...]:
        """The found axes in the root's frame of the draft, at a state of each of its columns; balls as small crosses.

        Each is drawn on the body that it was found on, by the tracker that its frame is.
        """
        poses = self.draft.poses(states)
        return tuple(
            line
            for joint in self.fit.tree.movable
            for line in _found_lines(joint, self._T_root_tracker(joint.parent, poses))
        )

    def _T_root_tracker(self, tracker: str, poses: Mapping[str, FloatArray]) -> FloatArray:
        """(4, 4) a tracker of the simulation, which may be a virtual one, at given poses of the draft's parts."""
        if tracker in poses:
            return poses[tracker]
        body = self.simulated.tree.body_of(tracker)
        truth = self.simulated.truth
        T = truth.T_ref_part[0]
        T_body_tracker = se3.inverse(T[truth.parts.index(body)]) @ T[truth.parts.index(tracker)]
        return poses[body] @ T_body_tracker

    def _found(self, score: JointScore) -> Joint | None:
        return None if score.found_joint is None else self.fit.tree.joint(score.found_joint)

    def _worst(self) -> str:
        errors = [score.axis_error_rad for score in self.scores.joints if score.axis_error_rad is not None]
        return f"; the worst axis is off by {_told(np.degrees(max(errors)), 'deg')}" if errors else ""


def run_trial(draft: Draft, settings: TrialSettings) -> Trial:
    """Simulate a draft and fit what was seen; seconds of work.

    The candidates of the fit are rigid, prismatic and revolute joints, and whatever other type is drawn.

    Raises:
        InvalidData: for settings that don't exist, and a draft of a single part, in which nothing can be found.
    """
    if len(draft.tree.parts) < 2:
        raise InvalidData(f"the draft has one part, '{draft.tree.root}': nothing moves against it; add a part first")
    simulated = simulate(draft.tree, settings.options(), settings.seed)
    types = tuple(dict.fromkeys(("rigid", "prismatic", "revolute", *(joint.type for joint in draft.joints))))
    found = fit(simulated.log, method=settings.method, joint_types=types)
    scores = score_tree(
        found.tree,
        simulated.tree,
        simulated.truth,
        found_states=found.states,
        true_states=simulated.states,
    )
    return Trial(draft, settings, simulated, found, scores)


def _found_lines(joint: Joint, T_root_parent: FloatArray) -> tuple[Line, ...]:
    T_root_axis = T_root_parent @ joint.geometry.T_parent_axis
    if joint.axis_parent is not None:
        return tuple(replace(line, what=f"found {line.what}") for line in arrow(T_root_axis, FOUND_COLOUR))
    ends = 0.2 * AXIS_M * np.eye(3)
    R, p = T_root_axis[:3, :3], T_root_axis[:3, 3]
    return tuple(Line("found centre", np.stack([p - R @ end, p + R @ end]), FOUND_COLOUR) for end in ends)


def _row(score: JointScore, found: Joint | None) -> TrialRow:
    axis_std = None if found is None else found.axis_std_rad
    point_std = None if found is None else found.point_std_m
    if found is not None and score.axis_error_rad is None and score.point_error_m is None:
        axis_std = point_std = None
    state = NOTHING
    if score.state_rms is not None and found is not None:
        state = _told(1e3 * score.state_rms, "mm") if found.unit == "m" else _told(np.degrees(score.state_rms), "deg")
    return TrialRow(
        true=score.joint,
        true_type=score.true_type,
        found=score.found_joint or NOTHING,
        found_type=score.found_type or "none",
        axis=_off(score.axis_error_rad, axis_std, float(np.degrees(1.0)), "deg"),
        point=_off(score.point_error_m, point_std, 1e3, "mm"),
        states=state,
        right=score.found_type == score.true_type,
    )


def _off(error: float | None, std: float | None, per_unit: float, unit: str) -> str:
    if error is None:
        return NOTHING
    told = _told(error * per_unit, unit)
    return told if std is None or not np.isfinite(std) else f"{told} (std {_told(std * per_unit, unit)})"


def _told(value: float, unit: str) -> str:
    if value < LEAST_TOLD:
        return f"< {LEAST_TOLD:g} {unit}"
    return f"{value:.3g} {unit}" if value < 1000 else f"{value:.0f} {unit}"
