"""Joint angles from rendered pictures against the Cramer-Rao bound at the noise that the detected corners have.

The demo's arm in smooth motion: lens distortion, blur, motion blur, a gamma that the detector doesn't know, noise,
JPEG, all of each seed's own. For each joint and fit the RMSE over the frames in which it has a state, and the
bound over the same frames; "linear" is the best linear estimate from the very corners, told the truth to start from.

Run: python -m tests.benchmarks.image_rendered [--trials N] [--seed N] [--workers N] [--quick]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from station.fit.image.views import Views
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.fit.result import Fit
from station.logs import FloatArray
from station.tracking import reestimate, track_parts, views_of
from tests.benchmarks.arguments import each, parser, trials_of
from tests.benchmarks.rendered_arm import RANGES_DEG, RenderedArm, rendered_arm
from tests.benchmarks.rendered_bound import joint_bounds
from tests.benchmarks.rendered_truth import corner_noise, part_bodies, state_errors

JOINTS = tuple(RANGES_DEG)
FITS = ("pose", "image")
# Medians are to be within this of the bound.
WANTED = 1.5
# A shift of edges is taken out of the poses where it is known by more than so many deviations.
SURE_SIGMAS = 3.0
QUICK_FRAMES, FRAMES = 150, 300


@dataclass(frozen=True)
class JointRun:
    """A joint of one seed by one fit, deg: RMSE, median of the stated deviations, bound and linear estimate.

    `covered` is the share of frames whose error is within two of the stated deviations.
    """

    rmse: float
    stated: float
    covered: float
    bound: float
    linear: float

    @property
    def ratio(self) -> float:
        """RMSE in units of the bound."""
        return self.rmse / self.bound


@dataclass(frozen=True)
class Run:
    """One seed: noise of the corners, true and found shift of edges [px], bodies found, joints by fit and name."""

    seed: int
    noise_px: float
    scale: tuple[float, ...]
    shift_px: float
    found_shift_px: float
    found_shift_std_px: float
    bodies_right: dict[str, bool]
    doubtful: int
    sightings: int
    joints: dict[tuple[str, str], JointRun]


def fitted(arm: RenderedArm, refine: str) -> Fit:
    """The arm's pictures, fitted; once more, as a session is, where the corners show that edges are seen shifted."""
    camera, seen = arm.truth.camera, arm.observations
    options = FitOptions(refine=refine)
    fit = learn(track_parts(seen, arm.table, camera).poses, options, views := _views(arm, refine))
    if fit.image is None or abs(fit.image.numbers.edge_shift_px) < SURE_SIGMAS * fit.image.numbers_std.edge_shift_px:
        return fit
    shifted = replace(camera, edge_shift_px=fit.image.numbers.edge_shift_px)
    return learn(track_parts(reestimate(seen, arm.table, shifted), arm.table, shifted).poses, options, views)


def _views(arm: RenderedArm, refine: str) -> Views | None:
    return views_of(arm.observations, arm.table, arm.truth.camera) if refine == "image" else None


def run_seed(job: tuple[int, int]) -> Run:
    """Render, detect, fit both ways, compare."""
    seed, frames = job
    arm = rendered_arm(seed, frames=frames)
    noise = corner_noise(arm.truth, arm.observations, arm.table, arm.truth.camera)
    bounds = joint_bounds(arm.truth, arm.observations, arm.table, noise)
    bodies = part_bodies(arm.truth, arm.table)
    joints: dict[tuple[str, str], JointRun] = {}
    fits = {refine: fitted(arm, refine) for refine in FITS}
    for refine, fit in fits.items():
        for name, errors in state_errors(fit, arm.truth, bodies).items():
            bound = bounds[name]
            seen = np.isfinite(errors.error_rad) & np.isfinite(bound.states[:, 0])
            error = errors.error_rad[seen] - errors.error_rad[seen].mean()
            linear = bound.state_errors[seen, 0] - bound.state_errors[seen, 0].mean()
            joints[refine, name] = JointRun(
                _rms_deg(error),
                float(np.degrees(np.median(errors.std_rad[seen]))),
                float(np.mean(np.abs(error) < 2 * errors.std_rad[seen])),
                float(np.degrees(np.sqrt(bound.states[seen, 0].mean()))),
                _rms_deg(linear),
            )
    image = fits["image"].image
    assert image is not None
    return Run(
        seed,
        noise.rms_px,
        tuple(noise.scale.tolist()),
        noise.edge_shift_px,
        image.numbers.edge_shift_px,
        image.numbers_std.edge_shift_px,
        {refine: bodies_right(fit, arm) for refine, fit in fits.items()},
        int(np.count_nonzero(image.doubtful)),
        len(image.views),
        joints,
    )


def bodies_right(fit: Fit, arm: RenderedArm) -> bool:
    """Whether parts are together just where they are on one body, and all joints turn."""
    bodies = part_bodies(arm.truth, arm.table)
    seen = {arm.table.markers[int(m)].part for m in np.unique(arm.table.rows(arm.observations.marker_id))}
    wanted = {frozenset(p for p in seen if bodies[p] == body) for body in bodies.values()}
    found = {frozenset(group) for group in fit.tree.rigid_groups}
    return found == {group for group in wanted if len(group) > 1} and all(j.type == "revolute" for j in fit.tree.joints)


def _rms_deg(error_rad: FloatArray) -> float:
    return float(np.degrees(np.sqrt(np.mean(error_rad**2))))


def show(runs: Sequence[Run]) -> None:
    """Print rows of seeds, then medians by joint and fit."""
    print(f"{'seed':>4}  {'noise':>6}  {'edge shift [px]':^24}  bodies right  {'doubtful':>12}   image fit / bound")
    print(
        f"{'':>4}  {'[px]':>6}  {'true':>7} {'found':>7} {'std':>8}  {'/'.join(FITS):>12}  {'':>12}   "
        + " ".join(JOINTS)
    )
    for run in runs:
        right = "/".join("yes" if run.bodies_right[refine] else "NO" for refine in FITS)
        ratios = [run.joints["image", name].ratio if ("image", name) in run.joints else np.nan for name in JOINTS]
        print(
            f"{run.seed:4}  {run.noise_px:6.4f}  {run.shift_px:7.4f} {run.found_shift_px:7.4f} "
            f"{run.found_shift_std_px:8.5f}  {right:>12}  {run.doubtful:5} of {run.sightings:4}   "
            + " ".join(f"{ratio:{len(name)}.2f}" for ratio, name in zip(ratios, JOINTS, strict=True))
        )
    print(f"\n{'':9}  {'':5}  {'medians over seeds, deg':^35}  {'RMSE / bound':^23}  linear  errors within")
    print(f"{'joint':9}  fit    {'RMSE':>8} {'bound':>8} {'linear':>8} {'stated':>8}  "
          f"{'median':>7} {'90 %':>7} {'most':>7}  /bound  2 std [%]   found")  # fmt: skip
    for name in JOINTS:
        for refine in FITS:
            these = [run.joints[refine, name] for run in runs if (refine, name) in run.joints]
            if not these:
                print(f"{name:9}  {refine:5}  never found")
                continue
            columns = [np.median([getattr(j, key) for j in these]) for key in ("rmse", "bound", "linear", "stated")]
            ratios = [j.ratio for j in these]
            spread = np.quantile(ratios, [0.5, 0.9, 1.0])
            linear = np.median([j.linear / j.bound for j in these])
            covered = 100 * np.mean([j.covered for j in these])
            said = "" if refine != "image" else "  within" if spread[0] <= WANTED else "  ABOVE"
            print(
                f"{name:9}  {refine:5}  " + " ".join(f"{x:8.4f}" for x in columns) + "  "
                + " ".join(f"{x:7.2f}" for x in spread)
                + f"  {linear:6.2f}  {covered:9.1f}   {len(these):2} of {len(runs)}{said}"
            )  # fmt: skip


def main() -> None:
    """Print the tables."""
    chosen = parser(__doc__, trials=20, quick=3).parse_args()
    frames = QUICK_FRAMES if chosen.quick else FRAMES
    seeds = range(chosen.seed, chosen.seed + trials_of(chosen))
    show(each(run_seed, [(seed, frames) for seed in seeds], chosen.workers))


if __name__ == "__main__":
    main()
