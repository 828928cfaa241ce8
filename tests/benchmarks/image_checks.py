"""How often a clean session is suspected of something, and how small a fault is found.

Clean sessions of several kinds: shares in which any test found anything; wanted: at most 1 % of all. Then, one thing
wrong at a time: in how many sessions it is found and named rightly, how well its time and size are told. Residuals are
those at the true poses, out of which the tests take all that a fit can do. Then the same after whole fits, of objects
that are made and seen as for the fit's own tests. Last, clean sessions of the demo's arm in rendered pictures of which
the detector's own errors are part (benchmark image_rendered): those with the right tree are counted apart.

Run: python -m tests.benchmarks.image_checks [--seed N] [--trials N] [--quick] [--workers N]
     [--only clean|faults|fitted|fitted-faults|rendered]
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from station.fit.image.views import Views
from station.fit.image_checks import LEVEL, ModelChecks, check_image
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.logs import PoseLog
from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.image_rendered import bodies_right, fitted
from tests.benchmarks.rendered_arm import rendered_arm
from tests.fit.image.simulated_views import Scene, Seeing
from tests.fit.image.simulated_views import watched as made_views
from tests.fit.image_checks.faulty_views import with_fault
from tests.fit.image_checks.watched_trees import Session, Wrong, watched

STATIC = Session()
KINDS: dict[str, Session] = {
    "static root": STATIC,
    "moving root": replace(STATIC, moving_root=True),
    "rests for most of the time": replace(STATIC, rests=0.7),
    "rests, moving root": replace(STATIC, rests=0.7, moving_root=True),
    "3 % outliers": replace(STATIC, outliers=0.03),
    "noise stated half": replace(STATIC, stated=0.5),
    "noise stated double": replace(STATIC, stated=2.0),
    "screw, slide, ball, hinge": replace(STATIC, types=("screw", "prismatic", "spherical", "revolute")),
    "two markers a part": replace(STATIC, markers=2),
    "three trackers on the root": replace(STATIC, trackers=2, types=("revolute", "prismatic")),
    "60 frames": replace(STATIC, frames=60),
    "half unseen": replace(STATIC, unseen=0.5),
}
AT_S = 9.0
# Seeds of rendered sessions count from here: none of them was looked at when the checks' allowances were chosen.
RENDERED_SEED, RENDERED_FRAMES = 1030, 300
SEEING = Seeing(correlated=True)
FITTED: dict[str, tuple[Scene, Seeing]] = {
    "static root": (Scene(joints=3), SEEING),
    "moving root": (Scene(joints=3, root_moves=True), SEEING),
    "steps and rests": (Scene(joints=3, course="steps"), SEEING),
    "3 % outliers": (Scene(joints=3), replace(SEEING, outliers=0.03)),
    "noise stated half": (Scene(joints=3), replace(SEEING, stated=0.5)),
    "noise stated double": (Scene(joints=3), replace(SEEING, stated=2.0)),
    "two trackers, two markers": (Scene(joints=3, trackers=(2, 2), markers=(2, 2)), SEEING),
    "all types of joints": (Scene(joints=4, kinds=("revolute", "prismatic", "screw", "spherical")), SEEING),
    "edges shifted by 0.1 px": (Scene(joints=3), replace(SEEING, edge_shift_px=0.1)),
    "a fifth missing": (Scene(joints=3), replace(SEEING, missing=0.2)),
}
FITTED_FAULTS: tuple[tuple[str, str, Wrong], ...] = (
    ("marker, 0.3 mm", "marker", Wrong(6.0, move=(3e-4, 0.0, 0.0, 0.0, 0.0, 0.0))),
    ("marker, 1 mm", "marker", Wrong(6.0, move=(1e-3, 0.0, 0.0, 0.0, 0.0, 0.0))),
    ("marker, 3 mm", "marker", Wrong(6.0, move=(3e-3, 0.0, 0.0, 0.0, 0.0, 0.0))),
    ("marker, 3 mm, 3 deg", "marker", Wrong(6.0, move=(3e-3, 0.0, 0.0, 0.0, 0.0, 0.05))),
    ("camera, 0.02 deg", "camera", Wrong(6.0, camera=(0.0, 0.0, 0.0, 0.0, 3.5e-4, 0.0))),
    ("camera, 0.2 deg", "camera", Wrong(6.0, camera=(0.0, 0.0, 0.0, 0.0, 3.5e-3, 0.0))),
    ("camera, 5 mm, 2 deg", "camera", Wrong(6.0, camera=(5e-3, 0.0, 0.0, 0.0, 0.035, 0.0))),
)


@dataclass(frozen=True)
class Fault:
    """Something wrong by a size, and which kind of finding tells it."""

    name: str
    kind: str
    sizes: tuple[float, ...]
    unit: str

    def wrong(self, size: float, rng: np.random.Generator) -> Wrong:
        """Of that size, in a random direction."""
        way = rng.standard_normal(3)
        way = size * way / np.linalg.norm(way)
        shift, turn = (*(1e-3 * way).tolist(), 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, *np.radians(way).tolist())
        made = {
            "shifted": lambda: Wrong(AT_S, marker=int(rng.integers(4)), move=shift),
            "turned": lambda: Wrong(AT_S, marker=int(rng.integers(4)), move=turn),
            "camera turned": lambda: Wrong(AT_S, camera=turn),
            "camera shifted": lambda: Wrong(AT_S, camera=shift),
            "drifted": lambda: Wrong(drift=shift),
            "focal": lambda: Wrong(focal=1.0 + 1e-2 * size),
            "lens": lambda: Wrong(k1=size),
            "edges": lambda: Wrong(edges_px=size),
            "tilt": lambda: Wrong(tilted_px=size),
        }
        return made[self.name]()


FAULTS = (
    Fault("shifted", "marker", (0.03, 0.1, 0.3, 1.0, 3.0), "mm"),
    Fault("turned", "marker", (0.1, 0.3, 1.0, 3.0), "deg"),
    Fault("camera turned", "camera", (0.003, 0.01, 0.03, 0.3), "deg"),
    Fault("camera shifted", "camera", (0.03, 0.1, 1.0), "mm"),
    Fault("drifted", "camera_drift", (0.03, 0.1, 1.0), "mm"),
    Fault("focal", "focal", (0.5, 1.0, 2.0, 4.0), "%"),
    Fault("lens", "place", (0.01, 0.03, 0.1), "k1"),
    Fault("edges", "edges", (0.05, 0.1, 0.2), "px"),
    Fault("tilt", "tilt", (0.03, 0.1, 0.3), "px"),
)


def try_clean(job: tuple[str, tuple[int, ...]]) -> tuple[str, ...]:
    """Kinds of what was found in a clean session."""
    kind, seed = job
    return tuple(f.kind for f in _checked(KINDS[kind], Wrong(), np.random.default_rng(seed)).findings)


def try_fault(job: tuple[int, float, tuple[int, ...]]) -> tuple[bool, int, float, float, float]:
    """Whether it was named rightly, findings beside it, error of its time [s], of that in deviations, its size."""
    number, size, seed = job
    rng, fault = np.random.default_rng(seed), FAULTS[number]
    wrong = fault.wrong(size, rng)
    findings = _checked(STATIC, wrong, rng).findings
    right = [f for f in findings if f.kind == fault.kind and f.marker_id in (None, wrong.marker + 3)]
    if not right:
        return False, len(findings), np.nan, np.nan, np.nan
    first = right[0]
    late = np.nan if first.t_s is None else first.t_s - AT_S + 0.025
    told = max((s.value for s in first.sizes if s.unit == fault.unit), default=np.nan)
    return True, len(findings) - 1, late, late / first.t_std_s if first.t_std_s else np.nan, told


def try_fitted(job: tuple[str, tuple[int, ...]]) -> tuple[str, ...]:
    """Kinds of what was found after a whole fit of a clean session."""
    kind, seed = job
    scene, seeing = FITTED[kind]
    made = made_views(seed, scene, seeing)
    return tuple(f.kind for f in _fitted(made.poses, made.views, scene.kinds).findings)


def try_fitted_fault(job: tuple[int, tuple[int, ...]]) -> tuple[bool, bool, float, bool]:
    """Whether anything was found, whether rightly named first, the error of its time [s], and whether it alone."""
    number, seed = job
    _, kind, wrong = FITTED_FAULTS[number]
    made = made_views(seed, Scene(joints=3), SEEING)
    wrong = replace(wrong, marker=int(np.random.default_rng(seed).integers(4)))
    findings = _fitted(*with_fault(made, wrong), made.seen.scene.kinds).findings
    right = [f for f in findings if f.kind == kind and f.marker_id in (None, wrong.marker)]
    late = np.nan if not right or right[0].t_s is None else right[0].t_s - wrong.t_s + 0.5 / 30
    return bool(findings), bool(right) and right[0] is findings[0], late, len(findings) == 1


def try_rendered(job: tuple[int, int]) -> tuple[bool, tuple[str, ...]]:
    """Whether the tree is right, and kinds of what was found in a clean session of rendered pictures."""
    arm = rendered_arm(job[0], frames=job[1])
    fit = fitted(arm, "image")
    assert fit.image is not None
    kinds = tuple(f.kind for f in check_image(fit.tree, fit.image).findings)
    return bodies_right(fit, arm), kinds


def _fitted(poses: PoseLog, views: Views, kinds: Sequence[str]) -> ModelChecks:
    """Of a fit that knows all types that there are: with a type missing a tree is wrong, and is found to be."""
    found = learn(poses, FitOptions(joint_types=("rigid", *kinds)), views)
    assert found.image is not None
    return check_image(found.tree, found.image)


def _checked(session: Session, wrong: Wrong, rng: np.random.Generator) -> ModelChecks:
    return check_image(*watched(session, wrong, rng))


def show_clean(seed: int, trials: int, workers: int) -> None:
    """Print how often clean sessions are suspected."""
    jobs = {kind: [(kind, (seed, number, i)) for i in range(trials)] for number, kind in enumerate(KINDS)}
    show_suspected("clean sessions", {kind: each(try_clean, these, workers) for kind, these in jobs.items()})


def show_fitted(seed: int, trials: int, workers: int) -> None:
    """Print how often clean sessions are suspected after whole fits."""
    jobs = {kind: [(kind, (seed, 200 + number, i)) for i in range(trials)] for number, kind in enumerate(FITTED)}
    show_suspected(
        "whole fits of clean sessions", {kind: each(try_fitted, these, workers) for kind, these in jobs.items()}
    )


def show_suspected(what: str, found: Mapping[str, Sequence[Collection[str]]]) -> None:
    """Print the findings of clean sessions by kind, and how many have one in all."""
    print(f"{what} with a finding; wanted in all at most {100 * LEVEL:g} %")
    for kind, of in found.items():
        names = ", ".join(sorted({name for names in of for name in names}))
        print(f"{kind:30} {sum(map(bool, of)):4d} of {len(of)}  {names}")
    everything = [names for of in found.values() for names in of]
    suspected, total = sum(map(bool, everything)), len(everything)
    print(f"all: {suspected} of {total}, {100 * suspected / total:.2f} %", flush=True)


def show_rendered(seed: int, trials: int, workers: int) -> None:
    """Print how often clean sessions of rendered pictures are suspected."""
    jobs = [(RENDERED_SEED + seed + i, RENDERED_FRAMES) for i in range(trials)]
    found = each(try_rendered, jobs, workers)
    right = {"right tree": [kinds for is_right, kinds in found if is_right]}
    wrong = {"wrong tree": [kinds for is_right, kinds in found if not is_right]}
    show_suspected("clean rendered sessions", {what: of for what, of in {**right, **wrong}.items() if of})


def show_fitted_faults(seed: int, trials: int, workers: int) -> None:
    """Print how often faults are found after whole fits, and named."""
    print(f"faults at t = 6 s of 10, whole fits, {trials} sessions each: shares in %")
    print(f"{'':24}{'found':>8}{'named first':>13}{'alone':>8}{'t RMS ms':>10}")
    for number, (name, _, _) in enumerate(FITTED_FAULTS):
        jobs = [(number, (seed, 300 + number, i)) for i in range(trials)]
        rows = np.array(each(try_fitted_fault, jobs, workers), dtype=float)
        late = rows[np.isfinite(rows[:, 2]), 2]
        rms_ms = 1e3 * np.sqrt(np.mean(late**2)) if len(late) else np.nan
        shares = 100 * rows[:, [0, 1, 3]].mean(axis=0)
        print(f"{name:24}{shares[0]:8.0f}{shares[1]:13.0f}{shares[2]:8.0f}{rms_ms:10.0f}", flush=True)


def _median(values: np.ndarray) -> float:
    """Of those that are known; NaN of none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


def show_faults(seed: int, trials: int, workers: int) -> None:
    """Print how often each fault is found, and how well it is told."""
    print(f"faults at t = {AT_S:g} s of 15, of {trials} sessions each, 0.1 px, 300 frames")
    print(f"{'':16}{'size':>10}{'found %':>9}{'beside':>8}{'t RMS ms':>10}{'t / std':>9}{'told':>9}")
    for number, fault in enumerate(FAULTS):
        for size in fault.sizes:
            jobs = [(number, size, (seed, 100 + number, i)) for i in range(trials)]
            rows = np.array(each(try_fault, jobs, workers), dtype=float)
            found = rows[rows[:, 0] > 0]
            late, rate, told = (np.sqrt(np.mean(found[:, 2] ** 2)) * 1e3, np.sqrt(np.mean(found[:, 3] ** 2)),
                                _median(found[:, 4])) if len(found) else (np.nan,) * 3  # fmt: skip
            print(
                f"{fault.name:16}{f'{size:g} {fault.unit}':>10}{100 * len(found) / len(rows):9.0f}"
                f"{rows[:, 1].mean():8.2f}{late:10.0f}{rate:9.2f}{told:9.3g}",
                flush=True,
            )


def main() -> None:
    """Parse the command line and print the tables."""
    options = parser(__doc__, trials=100, quick=10)
    options.add_argument("--only", choices=tuple(SHOWS))
    chosen = options.parse_args()
    for name, show in SHOWS.items():
        if chosen.only in (None, name):
            show(chosen.seed, trials_of(chosen), chosen.workers)


SHOWS = {
    "clean": show_clean,
    "faults": show_faults,
    "fitted": show_fitted,
    "fitted-faults": show_fitted_faults,
    "rendered": show_rendered,
}

if __name__ == "__main__":
    main()
