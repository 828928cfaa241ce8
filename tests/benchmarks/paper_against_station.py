"""The paper's method against the station's on the same simulated objects, and what each correction of the paper costs.

`python -m tests.benchmarks.paper_against_station` prints the tables of docs/paper_and_station.md; with `--out docs` it
draws its figures too. It takes some ten minutes; `--quick` a few.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from station.errors import InvalidData
from station.fit.learner import learn
from station.fit.paper import PaperSteps, Weights, learn_paper, unsmoothed, weighted_cost
from station.fit.result import Fit
from station.formats.tracks import parse_track
from station.logs import PoseLog
from tests.benchmarks import paper_corrections as corrections
from tests.benchmarks.arguments import each, parser, trials_of
from tests.fit.simulated import noisy_log, scores, simulated_tree
from tests.fit.test_real_tracks import FOLDER, TYPES

# Noise per axis of each tracker's pose; 0.5 deg of rotation for each millimetre.
NOISE_MM = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
DEG_PER_MM = 0.5
FRAMES = 100
METHODS = ("paper, true noise", "paper", "station")
# Bodies, and trackers on each.
CASES = {"one tracker a body": (4, 1), "two trackers a body": (3, 2)}


@dataclass(frozen=True)
class Outcome:
    """What one method made of one object: everything right, axis errors [deg] by joint that it has right, CPU time."""

    right: bool
    axis_deg: dict[int, float]
    cpu_s: float


def fit_by(method: str, log: PoseLog, sigma_m: float) -> Fit:
    """The log through one of `METHODS`.

    "paper" is the method with its own settings; "true noise" has it unsmoothed with the weights of relative poses whose
    noise is that of two parts.
    """
    if method == "station":
        return learn(log)
    if method == "paper":
        return learn_paper(log)
    both = np.sqrt(2.0)
    weights = Weights.of_noise(both * np.radians(DEG_PER_MM * sigma_m * 1e3), both * sigma_m)
    return learn_paper(log, steps=PaperSteps(smoothing=unsmoothed, cost=weighted_cost(weights)))


def outcome(job: tuple[int, int, int, float, str]) -> Outcome:
    """(seed, bodies, trackers, noise [m], method): simulate, fit, compare."""
    seed, bodies, trackers, sigma_m, method = job
    rng = np.random.default_rng([seed, bodies, trackers])
    truth = simulated_tree(rng, bodies=bodies, frames=FRAMES, trackers=(trackers, trackers))
    log = noisy_log(rng, truth, sigma_m=sigma_m, sigma_rad=np.radians(DEG_PER_MM * sigma_m * 1e3))
    begin = time.process_time()
    fit = fit_by(method, log, sigma_m)
    cpu_s = time.process_time() - begin
    found = scores(truth, log, fit.tree)
    off = {i: joint.axis_error_rad for i, joint in enumerate(found.joints)}
    return Outcome(found.types_correct, {i: np.degrees(rad) for i, rad in off.items() if rad is not None}, cpu_s)


@dataclass(frozen=True, eq=False)
class Comparison:
    """By method and noise (M, S): share of objects all right, median axis error [deg], CPU time [s]; numbers of both.

    Axis errors are of the joints that all methods have right.
    """

    case: str
    right: np.ndarray
    axis_deg: np.ndarray
    cpu_s: np.ndarray
    objects: int
    joints: np.ndarray


def compare_methods(case: str, seed: int, trials: int, workers: int) -> Comparison:
    """All methods on the same objects."""
    bodies, trackers = CASES[case]
    jobs = [
        (seed + i, bodies, trackers, sigma_mm * 1e-3, method)
        for method in METHODS
        for sigma_mm in NOISE_MM
        for i in range(trials)
    ]
    outcomes = np.array(each(outcome, jobs, workers), dtype=object).reshape(len(METHODS), len(NOISE_MM), trials)
    axis, joints = np.full(outcomes.shape[:2], np.nan), np.zeros(len(NOISE_MM), dtype=int)
    for s in range(len(NOISE_MM)):
        errors = [_common(outcomes[:, s, i]) for i in range(trials)]
        joined = np.concatenate(errors, axis=-1)
        joints[s] = joined.shape[-1]
        if joints[s]:
            axis[:, s] = np.median(joined, axis=-1)
    of = np.vectorize(lambda o: (float(o.right), o.cpu_s))(outcomes)
    return Comparison(case, of[0].mean(axis=-1), axis, of[1].mean(axis=-1), trials, joints)


def _common(by_method: Sequence[Outcome]) -> np.ndarray:
    """(M, J) axis errors of the joints of one object that all methods have right."""
    common = sorted(set.intersection(*(set(o.axis_deg) for o in by_method)))
    return np.array([[o.axis_deg[i] for i in common] for o in by_method]).reshape(len(by_method), -1)


def print_comparison(found: Comparison) -> None:
    """A row a method and a column a noise."""
    print(f"\n{found.case}: {found.objects} objects, {FRAMES} frames; noise of each tracker [mm], half as many degrees")
    print(f"{'':28s}" + "".join(f"{mm:>9g}" for mm in NOISE_MM))
    tables: tuple[tuple[str, np.ndarray, str], ...] = (
        ("all right [%]", 100 * found.right, "9.0f"),
        ("median axis error [deg]", found.axis_deg, "9.3f"),
        ("CPU time [s]", found.cpu_s, "9.2f"),
    )
    for what, values, form in tables:
        for method, row in zip(METHODS, values, strict=True):
            print(f"{what + ', ' + method:45s}" + "".join(f"{x:{form}}" for x in row))
    print(f"{'joints compared':45s}" + "".join(f"{n:9d}" for n in found.joints))


def measure_metric(seed: int, trials: int) -> object:
    """1 and 2: the metric's invariance and its gradient."""
    found, slopes = corrections.invariance(seed), corrections.gradients(seed)
    print(f"\n1 metric: off 1 by {found.left:.1e} (left), {found.turned:.1e} (rotations on the right) at most")
    for length_m in (0.01, 0.1, 1.0):
        k = int(np.argmin(np.abs(found.lengths_m - length_m)))
        low, middle, high = np.percentile(found.shifted[k], [5, 50, 95])
        print(f"  {1e3 * found.lengths_m[k]:5.0f} mm on the right: {middle:.2f} ({low:.2f} to {high:.2f})")
    print("2 gradient: largest error [1/rad], median angle to the central difference [deg]")
    for name, of in (("corrected", slopes.corrected), ("printed", slopes.printed), ("-printed", -slopes.printed)):
        off = np.median(slopes.misdirection_deg(of))
        print(f"  {name:10s} {np.abs(of - slopes.numeric).max():8.1e} {off:8.1e}")
    return found, slopes


def measure_starts(seed: int, trials: int) -> object:
    """4: the revolute start."""
    found = corrections.starts(seed, trials)
    for s, kind in enumerate(corrections.START_KINDS):
        exact = found.exact[s]
        print(f"\n4 start, {kind}: cost a frame on exact data {np.median(exact):.1e}, at most {exact.max():.1e}")
        print("  radius [mm], axis error [deg] at the start (median, 90 %), at the end, lost (> 5 deg), evaluations")
        for k, radius in enumerate(found.radii_m):
            both = (found.at_start[k, s], found.at_end[k, s])
            cells = [f"{np.median(error):7.2f} {np.percentile(error, 90):7.2f}" for error in both]
            lost, asked = np.sum(found.at_end[k, s] > 5), np.median(found.evaluations[k, s])
            print(f"  {1e3 * radius:5.0f} " + "  ".join(cells) + f"  {lost:4d} of {trials} {asked:5.0f}")
    return found


def measure_aic(seed: int, trials: int) -> object:
    """5 and 6: what AIC chooses for rigid pairs, and how that hangs on the weights."""
    rates = corrections.rigid_rates(seed, trials, (10, 20, 50, 100, 200, 400))
    print(f"\n5 called rigid [%] of {trials} rigid pairs, by frames" + "".join(f"{n:6d}" for n in rates.frames))
    for name in ("paper", "states_counted", "station"):
        print(f"  {name:50s}" + "".join(f"{100 * x:6.0f}" for x in getattr(rates, name)))
    overrated = corrections.overrated_noise(seed, trials)
    print("  travel [deg], and by how much weights must overrate the noise to call half rigid, and all")
    for travel, share in zip(overrated.travels_deg, overrated.rigid, strict=True):
        cells = [f"{overrated.factors[share >= of].min(initial=np.inf):6.1f}" for of in (0.5, 1.0)]
        print(f"  {travel:5.0f} " + " ".join(cells))
    return rates, overrated


def measure_smoothing(seed: int, trials: int) -> object:
    """6: what the low-pass filter does to the likelihood."""
    found = corrections.smoothed(seed, 10 * trials)
    print("\n6 cut-off, as a share of the frame rate; correlation of neighbouring frames; error over claimed deviation")
    for share, correlation, ratio in zip(found.shares, found.correlation, found.ratio, strict=True):
        print(f"  {share:5.2f} {correlation[1]:6.2f} {ratio:6.2f}")
    return found


def measure_rest(seed: int, trials: int) -> object:
    """3, 7, 8 and equation 21: relative poses, angles, the spanning tree, states of slides."""
    print("\n3 residual of the best hinge of an exact hinge on a moving base: rotation [deg], translation [mm]")
    for formula, (turn_deg, shift_mm) in corrections.conventions(seed).items():
        print(f"  {formula:14s} {turn_deg:8.1e} {shift_mm:8.1e}")
    sizes_deg = (1.0, 10.0, 45.0, 90.0)
    print("7 angle [deg] between (26) and the rotation vector of the same numbers, by its length [deg]")
    for size, off in zip(sizes_deg, corrections.angles_of_2013(seed, sizes_deg), strict=True):
        print(f"  {size:5.0f} {off:7.1f}")
    by_21, by_position = corrections.slide_errors(seed, trials)
    print("  rms error of a slide's states [mm], child at 0.3 m, by (21) and by the position along the axis")
    print(f"  {by_21:.2f} {by_position:.2f}")
    graphs = 200
    wrong, ours = corrections.wrong_trees(seed, graphs)
    print(
        f"8 spanning trees that aren't the lightest, of {graphs} with a weight of zero: SciPy {wrong}, station {ours}"
    )
    return None


def measure_tracks(seed: int, trials: int) -> object:
    """Real doors and drawers: joints named right, by the files' folders (of STATION_TRACKS, or beside the project)."""
    print(
        f"\nreal tracks: files, named right by the paper, by the station; {FOLDER if FOLDER.is_dir() else 'no folder'}"
    )
    for kind, joint_type in TYPES.items():
        logs = [parse_track(file.read_text("utf-8"), file.name) for file in sorted((FOLDER / kind).glob("*.log"))]
        right = [sum(names(method, log) == [joint_type] for log in logs) for method in ("paper", "station")]
        print(f"  {kind:20s} {joint_type:10s} {len(logs):3d} {right[0]:3d} {right[1]:3d}")
    return None


def names(method: str, log: PoseLog) -> list[str]:
    """Types of the joints that a method finds; none of a log that it refuses."""
    try:
        return [joint.type for joint in fit_by(method, log, np.nan).tree.joints]
    except InvalidData:
        return []


MEASURES: dict[str, Callable[[int, int], object]] = {
    "metric": measure_metric,
    "starts": measure_starts,
    "aic": measure_aic,
    "smoothing": measure_smoothing,
    "rest": measure_rest,
    "tracks": measure_tracks,
}


def main() -> None:
    """Measure, print, draw."""
    options = parser(__doc__, trials=30, quick=4)
    options.add_argument("--out", type=Path, default=None, help="folder for the figures")
    options.add_argument("--only", choices=(*MEASURES, *CASES), nargs="*", default=(*MEASURES, *CASES))
    chosen = options.parse_args()
    trials = trials_of(chosen)
    found = {name: measure(chosen.seed, trials) for name, measure in MEASURES.items() if name in chosen.only}
    compared = [compare_methods(case, chosen.seed, trials, chosen.workers) for case in CASES if case in chosen.only]
    for comparison in compared:
        print_comparison(comparison)
    if chosen.out is not None:
        from tests.benchmarks.paper_figures import draw

        draw(chosen.out, found, compared)


if __name__ == "__main__":
    main()
