"""Where fits to corners start wrong: far, frontal and oblique markers, faults, chains of hinges; and what is said.

Random objects of 3 to 6 joints, 100 frames, corner noise 0.05 to 0.3 px; in the hard rows more of that, and what the
row is named after. Each fit is held against one that starts from the true tree and states: a part is elsewhere in a
frame where its orientation differs from that one's by more than 0.5 deg, and than six of its deviations. In each row:

- runs; how many found other types of joints in the right structure; how many a tree with some of the right joints, and
  no others (parted); how many another tree; and how many of all these give no warning (unsaid);
- of runs with the right tree, how many have some part elsewhere in some frame, in how many of these some is unsaid;
- frames times parts in these runs: all, elsewhere, of these unsaid, and false alarms: in doubt, but right;
- elsewhere in the other runs, and of these unsaid; a tree in parts tells less of each, and errs more;
- processor time of a fit, median and most.

What misses is marked <.

Run: python -m tests.benchmarks.image_starts [--seed N] [--trials N] [--quick] [--only TEXT] [--workers N] [--listed]
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from station.errors import StationError
from station.fit.image.camera_numbers import unknowns
from station.fit.image.refinement import refine_image
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.result import Fit
from station.kinematics import se3
from station.logs import BoolArray, FloatArray
from station.tree_scores import score_tree
from tests.benchmarks.arguments import show_rows
from tests.fit.image.held_fits import rows_of
from tests.fit.image.simulated_views import Scene, Seeing, Watched, watched
from tests.fit.true_trees import true_tree

ELSEWHERE_RAD, ELSEWHERE_SIGMAS = float(np.radians(0.5)), 6.0
FRAMES, JOINTS = 100, (3, 6)
KINDS = (("revolute", "prismatic"), ("revolute",), ("revolute", "prismatic", "screw", "spherical"))
MUCH_PX, ANY_PX = (0.1, 0.3), (0.05, 0.3)


@dataclass(frozen=True)
class Hardness:
    """What a row changes: fields of the scene, of the seeing, the range of the noise, and whether all are hinges."""

    scene: dict[str, object]
    seeing: dict[str, object]
    sigma_px: tuple[float, float] = MUCH_PX
    hinges: bool = False


ROWS: dict[str, Hardness] = {
    "plain": Hardness({}, {}, ANY_PX),
    "far": Hardness({"distance_m": (1.0, 1.6)}, {}),
    "frontal": Hardness({"tilt_deg": (0.0, 35.0)}, {}),
    "oblique": Hardness({"tilt_deg": (60.0, 75.0)}, {}),
    "faults": Hardness({}, {"missing": 0.2, "outliers": 0.03}, ANY_PX),
    "hinges": Hardness({"distance_m": (0.9, 1.4)}, {}, hinges=True),
}

HEAD = """\
            |other                     |right tree, runs |right tree, frames x parts    |other trees     | fit, s
row     runs|types parted trees unsaid |elsewhere unsaid |  all elsewhere unsaid   false|elsewhere unsaid|med most"""


@dataclass(frozen=True)
class Trial:
    """One run.

    Attributes:
        mistake: empty for the right tree.
        kind: of it: "types", "parted" or "trees".
        warnings: of the fit.
        frames: frames times parts that both fits tell.
        elsewhere: of these; unsaid: of those elsewhere; false: in doubt, but right.
        seconds: of processor time.
    """

    mistake: str
    kind: str
    warnings: tuple[str, ...]
    frames: int
    elsewhere: int
    unsaid: int
    false: int
    seconds: float


def drawn(name: str, seed: int, trial: int) -> Watched:
    """The object and what is seen of it."""
    hard = ROWS[name]
    seeds = [seed, 7, list(ROWS).index(name), trial]
    rng = np.random.default_rng(seeds)
    kinds = KINDS[1] if hard.hinges else KINDS[int(rng.integers(len(KINDS)))]
    scene = Scene(
        joints=int(rng.integers(JOINTS[0], JOINTS[1] + 1)),
        kinds=kinds,
        root_moves=bool(rng.integers(2)),
        frames=FRAMES,
        course=("smooth", "steps")[int(rng.integers(2))],
    )
    sigma_px = float(np.exp(rng.uniform(*np.log(hard.sigma_px))))
    return watched(seeds, replace(scene, **hard.scene), replace(Seeing(sigma_px=sigma_px), **hard.seeing))


def run(job: tuple[str, int, int]) -> Trial:
    """(row, seed, trial)."""
    seen = drawn(*job)
    kinds = ("rigid", *sorted(set(seen.seen.scene.kinds)))
    poses, start = seen.poses, time.process_time()
    try:
        fit = learn(poses, FitOptions(joint_types=kinds, root=seen.tree.root), seen.views)
    except StationError as error:
        return Trial(f"{type(error).__name__}: {error}", "trees", ("failed",), 0, 0, 0, 0, time.process_time() - start)
    seconds = time.process_time() - start
    scores = score_tree(fit.tree, seen.tree)
    mistake = "" if scores.types_correct else next(iter(scores.mistakes), "wrong types")
    kind = "types" if scores.structure_correct else "parted" if is_parted(seen, fit) else "trees"
    return Trial(mistake, kind, fit.tree.warnings, *counted(seen, fit), seconds)


def is_parted(seen: Watched, fit: Fit) -> bool:
    """Whether all that is wrong is that joints are missing."""
    parts = seen.made.parts
    true = {frozenset((parts[joint.parent], parts[joint.child])) for joint in seen.made.joints}
    return all({joint.parent, joint.child} in true for joint in fit.tree.joints) and not fit.tree.rigid_groups


def counted(seen: Watched, fit: Fit) -> tuple[int, int, int, int]:
    """Frames times parts, those elsewhere, of these unsaid, and false alarms."""
    image = fit.image
    if image is None:
        return 0, 0, 0, 0
    parts = image.views.parts
    off, usual = turned(seen, parts, image.T_ref_part, still=stands_still(seen, parts, image.T_ref_part))
    both = np.isfinite(off)
    elsewhere = both & (off > np.maximum(ELSEWHERE_SIGMAS * usual, ELSEWHERE_RAD))
    doubt: BoolArray = np.zeros(off.shape, dtype=bool)
    rows = image.in_doubt & ~seen.outlier[rows_of(seen, image.views)]
    doubt[image.views.frame[rows], image.views.part[image.views.marker[rows]]] = True
    return (
        int(both.sum()),
        int(elsewhere.sum()),
        int((elsewhere & ~doubt).sum()),
        int((both & doubt & ~elsewhere).sum()),
    )


def stands_still(seen: Watched, parts: tuple[str, ...], T_ref_part: FloatArray) -> bool:
    """Whether a fit has the true root at rest: the fit that it is held against has so, too."""
    root = seen.made.parts[0]
    if seen.made.root != "static" or root not in parts:
        return seen.made.root == "static"
    T = T_ref_part[:, parts.index(root)]
    return bool(np.ptp(T[np.isfinite(T).all(axis=(-2, -1))], axis=0).max(initial=0.0) < 1e-9)


def turned(
    seen: Watched, parts: tuple[str, ...], T_ref_part: FloatArray, *, still: bool
) -> tuple[FloatArray, FloatArray]:
    """(T, K) [rad] by which parts are turned against a fit that starts from the truth, NaN where either has none; and
    (K,) by how much that one usually errs.
    """
    skeleton, model = true_tree(seen.made if still else replace(seen.made, root="moving"))
    best = refine_image(skeleton, model, seen.made.parts, seen.views, unknowns(seen.views.camera, 0.0)).image
    T_best = best.T_ref_part[:, [best.views.parts.index(part) for part in parts]]
    truth = seen.made.T_ref_part[:, [seen.made.parts.index(part) for part in parts]]
    return angle(T_best, T_ref_part), np.nanmedian(angle(truth, T_best), axis=0)


def angle(T: FloatArray, other: FloatArray) -> FloatArray:
    """(...) [rad] between poses; NaN for NaN."""
    known = np.isfinite(T).all(axis=(-2, -1)) & np.isfinite(other).all(axis=(-2, -1))
    found = np.full(known.shape, np.nan)
    found[known] = se3.angle((se3.inverse(T[known]) @ other[known])[..., :3, :3])
    return found


def row(name: str, found: list[Trial]) -> str:
    """One line of the table."""
    wrong = [trial for trial in found if trial.mistake]
    right = [trial for trial in found if not trial.mistake]
    types, parted, trees = (sum(trial.kind == kind for trial in wrong) for kind in ("types", "parted", "trees"))
    silent = sum(not trial.warnings for trial in wrong)
    runs = [sum(getattr(trial, what) > 0 for trial in right) for what in ("elsewhere", "unsaid")]
    frames, elsewhere, unsaid, false = (
        sum(getattr(trial, what) for trial in right) for what in ("frames", "elsewhere", "unsaid", "false")
    )
    of_wrong = [sum(getattr(trial, what) for trial in wrong) for what in ("elsewhere", "unsaid")]
    seconds = [trial.seconds for trial in found]
    return (
        f"{name:7} {len(found):4d}|{types:5d} {parted:6d} {trees:5d} {silent:6d}{mark(silent)}"
        f"|{runs[0]:9d} {runs[1]:6d}{mark(runs[1])}|{frames:5d} {elsewhere:9d} {unsaid:6d}{mark(unsaid)}"
        f"{100 * false / max(frames, 1):5.2f} %|{of_wrong[0]:9d} {of_wrong[1]:5d}{mark(of_wrong[1])}"
        f"|{np.median(seconds):3.1f} {max(seconds):4.1f}"
    )


def mark(count: int) -> str:
    """Of what should be none."""
    return "<" if count else " "


def main() -> None:
    """Print a row for each kind of hardness."""
    show_rows(__doc__, HEAD, ROWS, run, row, faults)


def faults(found: list[Trial]) -> Iterator[str]:
    """A line for each run with a fault."""
    for k, trial in enumerate(found):
        if trial.mistake or trial.elsewhere:
            what = f"{trial.mistake or 'right tree'} ({len(trial.warnings)} warnings)"
            where = f"of {trial.frames} {trial.elsewhere} elsewhere, {trial.unsaid} unsaid"
            yield f"trial {k}: {what}; {where}; {trial.seconds:.1f} s"


if __name__ == "__main__":
    main()
