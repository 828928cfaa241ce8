"""What does not move must not be called a joint, and what moves freely must not either.

Rigid pairs under noise: shares that were called movable, or not connected at all. A part against the log's reference,
and two trackers on one moving body; with independent errors, and, told apart, with errors that change slowly. Free
pairs: two parts that move independently, and one against the reference; shares for which a joint was reported, or one
body. Wanted: at most 1 %; a free pair is a forest of two trees. One of N trials is 100 / N %: see the totals.

Run: python -m tests.benchmarks.nulls [--seed N] [--trials N] [--quick] [--only rigid|free] [--all-types] [--workers N]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from station.fit.options import FitOptions
from station.logs import FloatArray
from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.made_joints import Faults, poses, random_poses, watch
from tests.benchmarks.read_fits import ALL_TYPES, DEFAULT_TYPES, attempt, found_type

RIGID_FRAMES, QUICK_RIGID_FRAMES = (20, 60, 200, 600, 2000), (20, 200)
RIGID_NOISES = ((0.1, 0.05), (1.0, 0.5), (3.0, 2.0), (30.0, 10.0))  # mm, deg for each axis
FREE_FRAMES, QUICK_FREE_FRAMES = (50, 200, 1000), (50, 200)
FREE_NOISES = ((1.0, 0.5), (3.0, 2.0))
SLOW_FRAMES = 8.0  # errors' correlation falls to 1/e
SWAY_M, SWAY_RAD = 0.15, 0.8
STEP_M, STEP_RAD = 0.01, 0.05
REACH_M = 0.5
WANTED_PERCENT = 1


@dataclass(frozen=True)
class Cell:
    """A kind of data, how many parts, frames, the noise [mm, deg], and how slowly errors change [frames]."""

    kind: str
    parts: int
    frames: int
    noise: tuple[float, float]
    error_frames: float = 0.0


def free_motion(rng: np.random.Generator, kind: str, frames: int) -> FloatArray:
    """(T, 4, 4) a smooth sway, a random walk, or a pose of its own in each frame."""
    start = random_poses(rng, REACH_M)
    if kind == "jumps":
        return random_poses(rng, REACH_M, frames)
    if kind == "walk":
        steps = rng.uniform(-1, 1, (frames, 6)) * np.repeat([STEP_M, STEP_RAD], 3)
        found = [start]
        for step in poses(steps[1:, 3:], steps[1:, :3]):  # each pose starts where the last one ended
            found.append(found[-1] @ step)
        return np.stack(found)
    t = np.linspace(0, 2 * np.pi, frames)[:, None]
    rate, phase = rng.uniform(0.5, 3.0, (2, 6)), rng.uniform(0, 2 * np.pi, (2, 6))
    sway = np.sin(t * rate[0] + phase[0]) + 0.5 * np.sin(2 * t * rate[1] + phase[1])
    return start @ poses(SWAY_RAD * sway[:, 3:], SWAY_M * sway[:, :3])


def true_poses(rng: np.random.Generator, cell: Cell) -> FloatArray:
    """(T, K, 4, 4)."""
    if cell.kind != "rigid":
        return np.stack([free_motion(rng, cell.kind, cell.frames) for _ in range(cell.parts)], axis=1)
    body = free_motion(rng, "smooth", cell.frames) if cell.parts > 1 else np.tile(np.eye(4), (cell.frames, 1, 1))
    return body[:, None] @ random_poses(rng, REACH_M / 2, cell.parts)


def try_cell(job: tuple[Cell, tuple[str, ...], list[int]]) -> str:
    """What the pair was said to be."""
    cell, joint_types, seed = job
    rng = np.random.default_rng(seed)
    mm, deg = cell.noise
    faults = Faults(error_frames=cell.error_frames)
    log = watch(rng, true_poses(rng, cell), 1e-3 * mm, float(np.radians(deg)), faults).log
    fit, failure = attempt(log, FitOptions(joint_types=joint_types))
    return failure if fit is None else found_type(fit.tree)


def wrong_answers(found: Sequence[str], right: str) -> str:
    """How often each wrong answer came, shortened; - for none."""
    wrong = sorted({name for name in found if name != right})
    return " ".join(f"{list(found).count(name)} {name[:4]}" for name in wrong) or "-"


def show_total(kind: str, found: Sequence[str], right: str) -> None:
    """Print the share of wrong answers of all cells of a kind."""
    percent = 100 * sum(name != right for name in found) / len(found)
    miss = " <" if percent > WANTED_PERCENT else ""
    print(f"all of {kind}: {percent:.2f} % of {len(found)} ({wrong_answers(found, right)}){miss}")


def show(
    title: str, right: str, cells: dict[tuple[str, int], list[Cell]], chosen: Sequence[int], types: Sequence[str]
) -> None:
    """Print a table with a row for each kind and number of frames, a column for each noise."""
    seed, trials, workers = chosen
    columns = next(iter(cells.values()))
    print(f"{title}: wrong answers of {trials}; wanted in all at most {WANTED_PERCENT} %")
    print(f"{'':22} {'frames':>6}  " + "".join(f"{f'{c.noise[0]:g} mm, {c.noise[1]:g} deg':17}" for c in columns))
    totals: dict[str, list[str]] = {}
    for (kind, frames), some in cells.items():
        said: list[str] = []
        for cell in some:
            key = [seed, *(ord(letter) for letter in kind), frames, round(100 * cell.noise[0])]
            found = each(try_cell, [(cell, tuple(types), [*key, i]) for i in range(trials)], workers)
            totals.setdefault(kind, []).extend(found)
            said.append(wrong_answers(found, right))
        print(f"{kind:22} {frames:6d}  " + "".join(f"{text:17}" for text in said), flush=True)
    for kind, found in totals.items():
        show_total(kind, found, right)


def rigid_cells(frames: Sequence[int]) -> dict[tuple[str, int], list[Cell]]:
    """Rows of the first table."""
    kinds = {
        "one against reference": (1, 0.0),
        "two on a moving body": (2, 0.0),
        "one, slow errors": (1, SLOW_FRAMES),
        "two, slow errors": (2, SLOW_FRAMES),
    }
    return {
        (name, n): [Cell("rigid", parts, n, noise, slow) for noise in RIGID_NOISES]
        for name, (parts, slow) in kinds.items()
        for n in frames
    }


def free_cells(frames: Sequence[int]) -> dict[tuple[str, int], list[Cell]]:
    """Rows of the second table."""
    kinds = [(kind, *parts) for parts in ((2, "two parts"), (1, "one part")) for kind in ("smooth", "walk", "jumps")]
    return {
        (f"{kind}, {name}", n): [Cell(kind, parts, n, noise) for noise in FREE_NOISES]
        for kind, parts, name in kinds
        for n in frames
    }


def main() -> None:
    """Print both tables."""
    options = parser(__doc__, trials=20, quick=5)
    options.add_argument("--only", choices=("rigid", "free"), help="one of the tables")
    options.add_argument("--all-types", action="store_true", help="every joint type is a candidate")
    chosen = options.parse_args()
    settings = (chosen.seed, trials_of(chosen), chosen.workers)
    types = ALL_TYPES if chosen.all_types else DEFAULT_TYPES
    if chosen.only != "free":
        frames = QUICK_RIGID_FRAMES if chosen.quick else RIGID_FRAMES
        show("Rigid pairs", "rigid", rigid_cells(frames), settings, types)
    if chosen.only != "rigid":
        frames = QUICK_FREE_FRAMES if chosen.quick else FREE_FRAMES
        show("Free pairs", "free", free_cells(frames), settings, types)


if __name__ == "__main__":
    main()
