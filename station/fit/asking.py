"""Learning as a talk: it asks which joint types explain pairs of bodies, is answered, and goes on.

A fit of a small object is hundreds of thousands of calls on arrays so short that the calls themselves are what takes
the time. So learning is a generator that yields its questions, and many logs are learned side by side: the pairs that
all of them ask about are fitted as one. What becomes of a pair doesn't depend on those that are fitted beside it.
Pieces of pairs run on all cores and keep memory bounded.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Generator, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.fit.known_joints import KnownJoints
from station.fit.pairwise import COST_TOLERANCE, LM_ITERATIONS, JointFit, PairTracks, fit_types
from station.fit.parallel import FRAMES_AT_ONCE, each, pieces
from station.fit.selection import Scores, score_fits

IntArray = NDArray[np.intp]
Told = TypeVar("Told")
Result = TypeVar("Result")

# Frames of all pairs that are fitted as one: more than in a piece, as calls on short arrays cost more than the cache.
MOST_FRAMES = 2 * FRAMES_AT_ONCE

# What asks questions, each answered before the next, and ends with a result.
Asking = Generator["Question[Any]", Any, Result]


@dataclass(frozen=True)
class Effort:
    """Frames of a pair to look at, spread evenly (None: all), least squares steps at most, and when they are enough."""

    frames: int | None
    iterations: int
    tolerance: float


SCREENING = Effort(frames=64, iterations=2, tolerance=0.1)
# Tells a pair's noise.
SURVEYING = Effort(frames=64, iterations=10, tolerance=0.1)
# Tells a pair's type and whether it is an edge; the tree's joints are fitted to all frames.
COMPARING = Effort(frames=200, iterations=10, tolerance=0.1)
FITTING = Effort(frames=None, iterations=LM_ITERATIONS, tolerance=COST_TOLERANCE)


@dataclass(frozen=True, eq=False)
class Explained:
    """P pairs, what was fitted to them, and its scores."""

    tracks: PairTracks
    fits: Mapping[str, JointFit]
    scores: Scores

    def take(self, rows: IntArray) -> Explained:
        """Some of the pairs."""
        fits = {name: fit.take(rows) for name, fit in self.fits.items()}
        return Explained(self.tracks.take(rows), fits, self.scores.take(rows))


@dataclass(frozen=True, eq=False)
class Question(Generic[Told]):
    """Which joint types explain pairs.

    Attributes:
        pairs: how many.
        frames: of the log; no pair has more.
        tracks: makes the tracks of some of the pairs: of all at once they may be too large.
        joint_types: the candidates.
        effort: to be made.
        criterion: by which types are scored.
        free: whether pairs may be free; see `score_fits`.
        told: what is kept of the pairs of a piece.
        known: of the pairs, to start at.
    """

    pairs: int
    frames: int
    tracks: Callable[[IntArray], PairTracks]
    joint_types: tuple[str, ...]
    effort: Effort
    criterion: str
    free: bool | None
    told: Callable[[Explained], Told]
    known: KnownJoints | None = None

    @property
    def frames_at_most(self) -> int:
        """That a pair is looked at in."""
        return self.frames if self.effort.frames is None else min(self.frames, self.effort.frames)

    @property
    def kind(self) -> Hashable:
        """What questions have in common that are answered together."""
        return self.joint_types, self.effort, self.criterion, self.free, self.known is None


def ask(question: Question[Told]) -> Asking[list[Told]]:
    """What was told of each piece of the pairs, in order."""
    return (yield question)


def answered(asking: Asking[Result]) -> Result:
    """What it comes to."""
    found = answered_all([asking])[0]
    if isinstance(found, InvalidData):
        raise found
    return found


def answered_all(askings: Sequence[Asking[Result]]) -> list[Result | InvalidData]:
    """What each comes to, or the error that ends it and no other; all their questions of a round are answered at once.

    The least effort comes first: those that ask for more wait, so that they are answered together.
    """
    results: dict[int, Result | InvalidData] = {}
    asked: dict[int, Question[Any]] = {}

    def go_on(i: int, answer: list[Any] | None) -> None:
        try:
            asked[i] = askings[i].send(answer)
        except StopIteration as end:
            results[i] = end.value
        except InvalidData as error:
            results[i] = error

    for i in range(len(askings)):
        go_on(i, None)
    while asked:
        least = min(question.effort.iterations for question in asked.values())
        now = {i: question for i, question in asked.items() if question.effort.iterations == least}
        for i, answer in zip(now, _answers(list(now.values())), strict=True):
            del asked[i]
            go_on(i, answer)
    return [results[i] for i in range(len(askings))]


@dataclass(frozen=True, eq=False)
class _Piece:
    """Some rows of a question's pairs; questions are numbered."""

    number: int
    question: Question[Any]
    rows: IntArray

    @property
    def size(self) -> int:
        return len(self.rows) * self.question.frames_at_most


def _answers(questions: Sequence[Question[Any]]) -> list[list[Any]]:
    """What each is told of its pieces."""
    work = [
        _Piece(i, question, rows)
        for i, question in enumerate(questions)
        for rows in pieces(question.pairs, question.frames_at_most)
    ]
    told: list[list[Any]] = [[] for _ in questions]
    packs = _packs(work)
    for pack, found in zip(packs, each(_told, packs), strict=True):
        for piece, one in zip(pack, found, strict=True):
            told[piece.number].append(one)
    return told


def _packs(work: Sequence[_Piece]) -> list[list[_Piece]]:
    """Pieces of one kind together, in order, up to MOST_FRAMES; those of one question apart, for cores to share."""
    packs: list[list[_Piece]] = []
    last: dict[Hashable, list[_Piece]] = {}
    for piece in work:
        pack = last.get(piece.question.kind, [])
        apart = not pack or pack[-1].number == piece.number
        if apart or sum(other.size for other in pack) + piece.size > MOST_FRAMES:
            pack = list[_Piece]()
            last[piece.question.kind] = pack
            packs.append(pack)
        pack.append(piece)
    return packs


def _told(pack: Sequence[_Piece]) -> list[Any]:
    """What is told of each piece; those with as many frames and one kind of noise are fitted together."""
    tracks = [piece.question.tracks(piece.rows) for piece in pack]
    alike: dict[Hashable, list[int]] = defaultdict(list)
    for i, some in enumerate(tracks):
        alike[some.seen.shape[1], some.noise.noisy is None].append(i)
    found: dict[int, Any] = {}
    for group in alike.values():
        joints = [known.take(pack[i].rows) for i in group if (known := pack[i].question.known) is not None]
        whole = _explained(
            pack[group[0]].question,
            PairTracks.all_of([tracks[i] for i in group]),
            KnownJoints.all_of(joints) if joints else None,
        )
        first = 0
        for i in group:
            rows = np.arange(first, first + len(tracks[i].seen), dtype=np.intp)
            found[i] = pack[i].question.told(whole.take(rows) if len(group) > 1 else whole)
            first += len(rows)
    return [found[i] for i in range(len(pack))]


def _explained(question: Question[Any], tracks: PairTracks, known: KnownJoints | None) -> Explained:
    effort = question.effort
    fits = fit_types(
        tracks, question.joint_types, iterations=effort.iterations, tolerance=effort.tolerance, known=known
    )
    return Explained(tracks, fits, score_fits(fits, tracks, question.criterion, free=question.free))
