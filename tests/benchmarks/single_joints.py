"""Single joints against the log's reference: is the type right, and how near is the fit to the Cramer-Rao bound.

200 frames, 3 mm and 0.02 rad for each axis, no settings. Medians over the trials. The bound is that of the frames in
which the part was seen, as though none were an outlier. `same` is the median error over that of the best linear
estimate from the same noise: a ratio without the scatter of the noise, which of 20 trials is 16 %. Wanted: the type
always; `same` at most 1.15, with 20 % outliers 1.4. What misses is marked <.

Run: python -m tests.benchmarks.single_joints [--seed N] [--trials N] [--quick] [--only TEXT] [--all-types]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.fit.learner import Fit
from station.fit.options import FitOptions
from station.kinematics.joints import JOINT_TYPES
from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.bounds import bound, median_norm
from tests.benchmarks.made_joints import SOUND, Faults, MadeJoint, single_joint, watch
from tests.benchmarks.read_fits import ALL_TYPES, attempt, axis_error_rad, candidates, found_type, point_error_m

FRAMES, STD_M, STD_RAD = 200, 0.003, 0.02
WANTED_RATIO, WANTED_WITH_OUTLIERS = 1.15, 1.4


@dataclass(frozen=True)
class Case:
    """A joint type, its travel [m or rad], the child's distance from the axis [m] and what is wrong with the log."""

    name: str
    kind: str
    travel: float = 0.0
    arm_m: float = 0.3
    faults: Faults = SOUND

    @property
    def wanted(self) -> float:
        """Largest ratio to the bound; infinite where none is promised."""
        if self.faults.outliers > 0.2:
            return np.inf
        return WANTED_WITH_OUTLIERS if self.faults.outliers else WANTED_RATIO


@dataclass(frozen=True)
class Trial:
    """One fit: the type found; error, median bound and the efficient estimate's error of axis [rad] and point [m]."""

    found: str
    axis: tuple[float, float, float]
    point: tuple[float, float, float]


def sound_cases() -> list[Case]:
    """All poses seen, none gross."""
    arcs = [(r, deg) for deg in (300, 90, 30, 10) for r in (0.0, 0.02, 0.3, 0.65)]
    cases = [Case("rigid", "rigid")]
    cases += [Case(f"prismatic {cm} cm", "prismatic", 0.01 * cm) for cm in (30, 5)]
    cases += [Case(f"revolute {deg} deg, r {100 * r:.0f} cm", "revolute", np.radians(deg), r) for r, deg in arcs]
    cases += [Case(f"screw {deg} deg, r 30 cm", "screw", np.radians(deg)) for deg in (300, 90)]
    cases += [Case(f"spherical 60 deg, r {100 * r:.0f} cm", "spherical", np.radians(60), r) for r in (0.0, 0.3)]
    return cases


def faulty_cases() -> list[Case]:
    """With outliers, and with frames in which the part was not seen."""
    faulty = {"20 % outliers": Faults(outliers=0.2), "40 % outliers": Faults(outliers=0.4)}
    faulty["30 % missing"] = Faults(missing=0.3)
    some = [("rigid", 0.0), ("prismatic", 0.3), ("revolute", np.pi / 2), ("screw", 5.0), ("spherical", 1.0)]
    return [Case(f"{kind}, {name}", kind, q, 0.3, faults) for name, faults in faulty.items() for kind, q in some]


def position_cases() -> list[Case]:
    """Positions alone: enough of a curve to have a shape."""
    faults = Faults(positions_only=True)
    cases = [Case("pos. rigid", "rigid", faults=faults), Case("pos. prismatic 30 cm", "prismatic", 0.3, faults=faults)]
    curves = [
        ("revolute", 300, 30),
        ("revolute", 90, 30),
        ("revolute", 90, 65),
        ("screw", 300, 30),
        ("spherical", 90, 30),
    ]
    for kind, deg, cm in curves:
        cases.append(Case(f"pos. {kind} {deg} deg r {cm}", kind, np.radians(deg), 0.01 * cm, faults))
    return cases


def try_case(job: tuple[Case, tuple[str, ...], list[int]]) -> Trial:
    """Make one joint, learn it, compare."""
    case, joint_types, seed = job
    rng = np.random.default_rng(seed)
    made = single_joint(rng, case.kind, frames=FRAMES, travel=case.travel, arm_m=case.arm_m)
    watched = watch(rng, made.T_ref_part, STD_M, STD_RAD, case.faults)
    fit, failure = attempt(watched.log, FitOptions(joint_types=joint_types))
    if fit is None:
        return Trial(failure, (np.nan, np.nan, np.nan), (np.nan, np.nan, np.nan))
    least = bound(
        made,
        watched.noise,
        STD_M,
        STD_RAD,
        seen=watched.log.seen.astype(float),
        positions_only=case.faults.positions_only,
    )
    axis, point = errors(fit, made.joints[0])
    best = least.efficient
    return Trial(
        found_type(fit.tree),
        (axis, median_norm(least.axis(0)), float(np.linalg.norm(best[least.axis_columns[0]]))),
        (point, median_norm(least.point(0)), float(np.linalg.norm(best[least.point_columns[0]]))),
    )


def errors(fit: Fit, truth: MadeJoint) -> tuple[float, float]:
    """Axis [rad] and point [m] of a fit of the right type; NaN for another, and where the type has none."""
    if found_type(fit.tree) != truth.type or not fit.tree.joints:
        return np.nan, np.nan
    joint = fit.tree.joints[0]
    axis = np.nan if joint.axis_parent is None else axis_error_rad(joint.axis_parent, truth.axis)
    if joint.point_parent_m is None:
        return axis, np.nan
    known = None if joint.axis_parent is None else truth.axis
    return axis, point_error_m(joint.point_parent_m, truth.point_m, known)


def columns(triples: list[tuple[float, float, float]], unit: float, wanted: float) -> str:
    """Median error, bound, ratio, ratio to the efficient estimate of the same noise; blank without any."""
    values = np.array(triples)
    values = values[np.isfinite(values[:, 0])]
    if not len(values):
        return f"{'-':>7} {'-':>7} {'-':>5} {'-':>5} "
    error, least, best = np.median(values, axis=0)
    miss = "<" if error / best > wanted else " "
    return f"{error * unit:7.3f} {least * unit:7.3f} {error / least:5.2f} {error / best:5.2f}{miss}"


def row(case: Case, trials: list[Trial]) -> str:
    """One line of the table."""
    right = sum(trial.found == case.kind for trial in trials)
    said = f"{right}/{len(trials)}" + (" " if right == len(trials) else "<")
    axis = columns([trial.axis for trial in trials], np.degrees(1.0), case.wanted)
    point = columns([trial.point for trial in trials], 1e3, case.wanted)
    return f"{case.name:26} {said:>8}| {axis}| {point}"


def main() -> None:
    """Print a row a case."""
    options = parser(__doc__, trials=20, quick=5)
    options.add_argument("--only", default="", help="cases whose name has this in it")
    options.add_argument("--all-types", action="store_true", help="every joint type is a candidate in every case")
    chosen = options.parse_args()
    print(f"{'':26} {'right':>7} | {'axis [deg]':^27} | {'point [mm]':^27}")
    print(f"{'case':26} {'type':>7} |" + f" {'error':>7} {'bound':>7} {'ratio':>5} {'same':>5} |" * 2)
    wrong: list[str] = []
    for number, case in enumerate([*sound_cases(), *faulty_cases(), *position_cases()]):
        if chosen.only not in case.name:
            continue
        if case.kind not in JOINT_TYPES:
            print(f"{case.name:26} no such joint type yet")
            continue
        types = ALL_TYPES if chosen.all_types else candidates(case.kind)
        jobs = [(case, types, [chosen.seed, number, trial]) for trial in range(trials_of(chosen))]
        trials = each(try_case, jobs, chosen.workers)
        print(row(case, trials), flush=True)
        missed = [trial.found for trial in trials if trial.found != case.kind]
        wrong += [f"{case.name}: called {name} {missed.count(name)} times" for name in sorted(set(missed))]
    print("\n".join(wrong))


if __name__ == "__main__":
    main()
