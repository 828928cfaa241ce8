"""All tests of a session: which is the surest, allowed for, then which of the others is still needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from station.fit.image.image_fit import ImageFit
from station.fit.image.views import COORDINATES
from station.fit.image_checks.body_steps import body_step
from station.fit.image_checks.changes import Effect, constant_effect, log_chance, step_effect
from station.fit.image_checks.directions import CAMERA, EDGES, FOCAL, PLACE, TILT, Rows, whitened_rows
from station.fit.image_checks.findings import LEVEL, Finding, ModelChecks
from station.fit.image_checks.freedoms import Freedoms, freedoms, key
from station.fit.image_checks.moves import Move, changed, improved
from station.fit.image_checks.priors import against_calibration, calibration_allowed
from station.fit.image_checks.sums import Sums, marker_name, part_name, sums
from station.fit.image_checks.weighing import weights
from station.fit.image_checks.words import About, is_large, told
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray

# More than these are one: the tree is wrong.
MOST_FINDINGS = 8
# What is likelier by less than this factor might as well be the other.
CLEARLY = 100.0
# Moves beyond this, m and rad, aren't what they are taken for: nothing is linear over them.
LARGEST = (0.03, 0.5)
# Of gains above this, a tree may have been drawn far off; then so many are tried.
LARGE, TRIED = 1000.0, 3
# Gauss-Newton steps after a move was found.
STEPS = 4
STEP, RAMP, ALWAYS = "step", "ramp", "always"


@dataclass(frozen=True)
class Question:
    """One test: what may be wrong, and how it goes over time."""

    kind: str
    what: str
    when: str

    @property
    def is_move(self) -> bool:
        """Whether it is about something that moves."""
        return self.kind in ("marker", "part", "camera", "camera_drift")


@dataclass(frozen=True, eq=False)
class _State:
    """A fit with the moves that were found in its residuals, and what is allowed for besides."""

    tree: KinematicTree
    image: ImageFit
    rows: Rows
    free: Freedoms
    own: Sums
    moves: tuple[Move, ...]
    others: tuple[tuple[str, FloatArray], ...]

    @property
    def base(self) -> Sums:
        """Sums of a fit that may do all that was found."""
        found = self.moving
        for what, profile in self.others:
            found = found.allowing(what, profile)
        return found

    @property
    def moving(self) -> Sums:
        """Sums of a fit that may change the moves."""
        found = self.own
        for what, profile in self._profiles():
            found = found.allowing(what, profile)
        return found

    def _profiles(self) -> list[tuple[str, FloatArray]]:
        begins = np.flatnonzero(np.diff(self.own.tick, prepend=-1))
        return [(move.what, move.profile[begins]) for move in self.moves]

    def with_moves(self, moves: Sequence[Move]) -> _State:
        """The same with other moves in the residuals."""
        image = changed(self.image, self.image.T_ref_part, self.moves, moves)
        return _state(self.tree, image, moves, self.others)

    def improved(self) -> _State:
        """Poses and moves where the sums say, with the camera's numbers as they are."""
        added = self._profiles()
        image, moves = improved(self.tree, self.image, self.rows, self.free, self.moving, added, self.moves)
        return _state(self.tree, image, moves, self.others)


def _state(
    tree: KinematicTree, image: ImageFit, moves: Sequence[Move], others: Sequence[tuple[str, FloatArray]]
) -> _State:
    rows, free = whitened_rows(image, weights(image)), freedoms(tree, image)
    return _State(tree, image, rows, free, sums(image, rows, free), tuple(moves), tuple(others))


def check_image(tree: KinematicTree, image: ImageFit) -> ModelChecks:
    """Test what the corners of an image fit leave unexplained.

    Args:
        tree: as fitted; its poses are `image.T_ref_part`.
        image: of the same fit.

    Returns:
        Findings that in at most one of a hundred clean sessions are there at all.
    """
    state = _state(tree, image, (), ())
    if not len(state.rows.rows):
        return ModelChecks(untested=("no corners were seen of parts whose poses the fit tells",))
    questions = _questions(image, state.own)
    asked = _effects(state, questions)
    steps = _steps_of_bodies(state)
    tests = len(asked) + len(steps)
    untested = _untested(image, [question for question, _ in asked], steps)
    findings: list[Finding] = []
    found: list[Question] = []
    while len(findings) < MOST_FINDINGS and (sure := [pair for pair in asked if _log_p(pair, tests) < np.log(LEVEL)]):
        question, effect, state, is_clear = _best_allowed(state, sure)
        log_p = _log_p((question, effect), tests)
        alike = [
            (q, e) for q, e in asked if question.when == q.when and question.is_move == q.is_move and q != question
        ]
        or_else = [q.what for q, e in alike if _as_well(e, effect)] if is_clear else []
        found.append(question)
        findings.append(told(About(image, state.rows), question.kind, effect, float(np.exp(log_p)), or_else))
        asked = _effects(state, [q for q in questions if q.when == STEP or q not in found]) if is_clear else []
    for effect in (_steps_of_bodies(state) if findings and steps else steps)[:1]:
        # What was found before may have drawn the bodies along: then it has to have been there from the start.
        log_p = max(effect.log_p, steps[0].log_p) + float(np.log(tests))
        if log_p < np.log(LEVEL) and is_large(effect):
            findings.append(told(About(image, state.rows), "camera", effect, float(np.exp(log_p)), ()))
    return ModelChecks(tuple(findings), tests, LEVEL, untested)


def _steps_of_bodies(state: _State) -> list[Effect]:
    """Bodies of trees whose root moves, that themselves stand still but for one step; the surest first."""
    tree, found = state.tree, list[Effect]()
    for root in tree.tree_roots:
        if key("state", root) in state.free.columns:
            bodies = [root, *(joint.child for joint in tree.outward(root))]
            effects = [body_step(tree, state.image, state.rows, state.own, body) for body in bodies]
            found += [effect for effect in effects if effect is not None]
    return sorted(found, key=lambda effect: effect.log_p)


def _log_p(pair: tuple[Question, Effect], tests: int) -> float:
    return pair[1].log_p + float(np.log(tests))


def _merit(pair: tuple[Question, Effect]) -> float:
    """What it explains, in units that all share, less what its numbers explain by chance."""
    return pair[1].explained - 2.0 * pair[1].directions


def _is_plausible(question: Question, effect: Effect) -> bool:
    if not question.is_move:
        return True
    return bool(np.linalg.norm(effect.size[:3]) < LARGEST[0] and np.linalg.norm(effect.size[3:]) < LARGEST[1])


def _best_allowed(state: _State, sure: Sequence[tuple[Question, Effect]]) -> tuple[Question, Effect, _State, bool]:
    """What explains the corners best, with the state that allows for it, and whether it is near enough to go on.

    Of large moves the sums tell little, as they go by slopes where the fit came to rest: the likeliest few are tried.
    """
    plausible = [pair for pair in sure if _is_plausible(*pair)]
    tried = sorted(plausible or sure, key=_merit, reverse=True)[:TRIED]
    if _merit(tried[0]) < LARGE:
        tried = tried[:1]
    outcomes = [(question, *_allowing(state, question, effect)) for question, effect in tried]
    costs = [_cost(outcome[2]) for outcome in outcomes]
    question, effect, allowed = outcomes[int(np.argmin(costs))]
    return question, effect, allowed, bool(plausible) and min(costs) <= _cost(state)


def _cost(state: _State) -> float:
    """Of corners that lie off; of those that lie far off, little more."""
    views, residual = state.image.views, state.image.residual_px
    known = np.isfinite(residual).all(axis=1)
    white = np.linalg.solve(views.covariance_px2[known], residual[known, :, None])[..., 0]
    return float(np.sum(np.log1p(np.sum(residual[known] * white, axis=1) / COORDINATES)))


def _allowing(state: _State, question: Question, effect: Effect) -> tuple[Effect, _State]:
    """Something that was found, told again about the numbers as they are with it; and the state that allows for it."""
    if not question.is_move:
        return effect, replace(state, others=(*state.others, (effect.what, effect.profile)))
    settled = _settled(state, _move(state, effect))
    if question.when == STEP:  # its time again, now that the tree is no longer drawn by it
        without = settled.with_moves(settled.moves[:-1])
        allowed, _ = calibration_allowed(without.base, without.image)
        again = step_effect(allowed, question.what)
        if again.directions and _is_plausible(question, again):
            effect = replace(again, log_p=effect.log_p)
            settled = _settled(without, _move(without, again))
    if _is_plausible(question, replace(effect, size=settled.moves[-1].twist)):
        effect = replace(effect, size=settled.moves[-1].twist)
    return effect, settled


def _move(state: _State, effect: Effect) -> Move:
    return Move(effect.what, effect.profile[state.own.tick], effect.size)


def _settled(state: _State, move: Move) -> _State:
    """The state with one more move, and all numbers where they belong then."""
    state = state.with_moves((*state.moves, move))
    for _ in range(STEPS):
        better = state.improved()
        if _cost(better) > _cost(state):
            break
        state = better
    return state


def _questions(image: ImageFit, base: Sums) -> list[Question]:
    views = image.views
    counts = np.bincount(views.part, minlength=len(views.parts))
    asked = [Question("marker", marker_name(m), STEP) for m in range(len(views.marker_id))]
    asked += [Question("part", part_name(k), STEP) for k in np.flatnonzero(counts > 1).tolist()]
    asked += [Question("camera", CAMERA, STEP), Question("camera_drift", CAMERA, RAMP)]
    asked += [Question("focal", FOCAL, ALWAYS), Question("focal_drift", FOCAL, RAMP)]
    if views.camera.edge_shift_px is not None:
        asked.append(Question("edges", EDGES, ALWAYS))
    return [*asked, Question("place", PLACE, ALWAYS), Question("tilt", TILT, ALWAYS)]


def _effects(state: _State, questions: Sequence[Question]) -> list[tuple[Question, Effect]]:
    """Those that the corners tell anything of, each with what was found."""
    base, image = state.base, state.image
    ones, ramp = np.ones(len(base.start_s)), _ramp(base)
    bases: dict[str, Sums] = {}
    found: list[tuple[Question, Effect]] = []
    for question in questions:
        asked = question.what if question.when == ALWAYS else ""
        if asked not in bases:
            bases[asked], _ = calibration_allowed(base, image, but=asked)
        if question.when == STEP:
            effect = step_effect(bases[asked], question.what)
        elif question.when == RAMP:
            effect = constant_effect(bases[asked], question.what, ramp)
        else:
            effect = constant_effect(bases[asked], question.what, ones)
            effect = against_calibration(image, state.rows, effect, log_chance) if effect.directions else effect
        if effect.directions:
            found.append((question, effect))
    return found


def _ramp(base: Sums) -> FloatArray:
    """(n,) from -1/2 at the first tick to 1/2 at the last."""
    t = 0.5 * (base.start_s + base.end_s)
    return (t - t[0]) / max(float(t[-1] - t[0]), 1e-12) - 0.5


def _as_well(other: Effect, best: Effect) -> bool:
    """Whether another way to be wrong explains nearly as much, in units of the same noise."""
    return other.explained > best.explained - 2.0 * best.noise * np.log(CLEARLY)


def _untested(image: ImageFit, asked: Sequence[Question], steps: Sequence[Effect]) -> tuple[str, ...]:
    kinds = {question.kind for question in asked}
    found: list[str] = []
    if "camera" not in kinds and not steps:
        found.append("whether the camera moved, as nothing that it sees stands still")
    if image.views.camera.edge_shift_px is None:
        found.append("the edge shift, of which the calibration says nothing")
    silent = [f"marker {image.views.marker_id[m]}" for m in range(len(image.views.marker_id))]
    silent = [name for m, name in enumerate(silent) if marker_name(m) not in {question.what for question in asked}]
    return (*found, *(f"{name}, of whose place the corners tell nothing" for name in silent))
