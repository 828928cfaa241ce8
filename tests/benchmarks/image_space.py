"""The tree from corners against the Cramer-Rao bound on the same frames: states, geometry, what is stated, minima.

Objects of 3 to 6 joints, half of the runs smooth and half step by step, markers of 50 mm at 0.6 m before a camera of
640 x 480 px, f = 600 px, tilts to 75 deg, 300 frames, the edge shift unknown. In each row: runs, and how many found
another tree; of the rest, over all joints, the state's root mean square error over the bound's in that run (median, and
the share within 1.1, wanted 95 %); the share within 1.1 of the best linear estimate of the very noise: by chance, as
what all frames share errs by few numbers, no estimate does better; the share within 1.1 of that estimate, wanted 95 %;
the median of the pose fit; in how many runs the fit was in a wrong minimum in some frame, and in how many of these
it didn't say so; and the shares of 95 % regions that hold the truth, of states, axes and points (wanted 93 to 97 %);
the last two of the best linear estimate, whose covariance is exact: they are 95 % but for chance. What misses has a <.

Run: python -m tests.benchmarks.image_space [--seed N] [--trials N] [--quick] [--only TEXT] [--workers N] [--listed]
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from station.errors import StationError
from tests.benchmarks.arguments import show_rows
from tests.fit.image.held_fits import HeldFit, fitted, held
from tests.fit.image.simulated_views import Scene, Seeing, watched

WITHIN, WANTED_SHARE = 1.1, 0.95
WANTED_INSIDE = (0.93, 0.97)
JOINTS = (3, 6)
ALL_KINDS = ("revolute", "prismatic", "screw", "spherical")
STATIC, MOVING = Scene(), Scene(root_moves=True)
ROWS: dict[str, tuple[Scene, Seeing]] = {
    "static root, 0.05 px": (STATIC, Seeing(sigma_px=0.05)),
    "static root, 0.1 px": (STATIC, Seeing(sigma_px=0.1)),
    "static root, 0.3 px": (STATIC, Seeing(sigma_px=0.3)),
    "moving root, 0.05 px": (MOVING, Seeing(sigma_px=0.05)),
    "moving root, 0.1 px": (MOVING, Seeing(sigma_px=0.1)),
    "moving root, 0.3 px": (MOVING, Seeing(sigma_px=0.3)),
    "0-25 deg, 0.1 px": (replace(STATIC, tilt_deg=(0.0, 25.0)), Seeing(sigma_px=0.1)),
    "25-50 deg, 0.1 px": (replace(STATIC, tilt_deg=(25.0, 50.0)), Seeing(sigma_px=0.1)),
    "50-75 deg, 0.1 px": (replace(STATIC, tilt_deg=(50.0, 75.0)), Seeing(sigma_px=0.1)),
    "1-2 trackers a body": (replace(STATIC, trackers=(1, 2)), Seeing(sigma_px=0.1)),
    "1-2 markers a tracker": (replace(MOVING, markers=(1, 2)), Seeing(sigma_px=0.1)),
    "all joint types": (replace(STATIC, kinds=ALL_KINDS), Seeing(sigma_px=0.1)),
    "all types, moving root": (replace(MOVING, kinds=ALL_KINDS), Seeing(sigma_px=0.1)),
    "edges off by -0.3 px": (STATIC, Seeing(sigma_px=0.1, correlated=True, edge_shift_px=-0.3)),
    "noise told as half": (STATIC, Seeing(sigma_px=0.1, stated=0.5)),
    "10 % missing": (STATIC, Seeing(sigma_px=0.1, missing=0.1)),
    "3 % outliers": (STATIC, Seeing(sigma_px=0.1, outliers=0.03)),
}


HEAD = """\
                            wrong |   image fit: within 1.1   | poses| elsewhere |  regions hold, %   |  chance, %
scene                  runs trees |median bound  chance  both |median|runs unsaid|state   axis  point | axis  point"""


@dataclass(frozen=True)
class Trial:
    """One run: what is wrong with the tree, or of each joint the numbers of the table.

    Attributes:
        mistake: empty for the right tree.
        said: whether a wrong tree comes with a warning.
        ratios: (J, 3) of the image fit, of the best linear estimate, of the pose fit (NaN where its tree is wrong).
        inside: (J, 5) states, axes and points; axes and points of the best linear estimate.
        wrong: frames in another minimum; unsaid: those of which nothing is said.
    """

    mistake: str
    said: bool
    ratios: list[list[float]]
    inside: list[list[float]]
    wrong: int
    unsaid: int


def run(job: tuple[str, int, int]) -> Trial:
    """(row, seed, trial)."""
    name, seed, trial = job
    scene, seeing = ROWS[name]
    seeds = [seed, list(ROWS).index(name), trial]
    joints = int(np.random.default_rng(seeds).integers(JOINTS[0], JOINTS[1] + 1))
    course = ("smooth", "steps")[trial % 2]
    found = watched(seeds, replace(scene, joints=joints, course=course), seeing)
    try:
        fit = held(found, fitted(found))
        by_poses = held(found, fitted(found, image=False))
    except StationError as error:
        return Trial(f"{type(error).__name__}: {error}", True, [], [], 0, 0)
    if fit.mistakes:
        return Trial(fit.mistakes[0], bool(fit.fit.tree.warnings), [], [], 0, 0)
    return told(fit, by_poses)


def told(fit: HeldFit, by_poses: HeldFit) -> Trial:
    pose = [joint.ratio for joint in by_poses.joints] or [np.nan] * len(fit.joints)
    return Trial(
        "",
        False,
        [[joint.ratio, joint.chance, p] for joint, p in zip(fit.joints, pose, strict=True)],
        [
            [joint.states_inside, joint.axis_inside[0], joint.point_inside[0], *joint.inside_by_chance]
            for joint in fit.joints
        ],
        int(fit.wrong.sum()),
        int((fit.wrong & ~fit.told).sum()),
    )


def share(values: np.ndarray, least: float, most: float = 1.0) -> str:
    """Percentage, and a mark where it misses by more than its standard error."""
    values = values[np.isfinite(values)]
    if not len(values):
        return f"{'-':>5} "
    mean, error = float(np.mean(values)), float(np.std(values) / np.sqrt(len(values)))
    return f"{100 * mean:5.1f}{' ' if least - error <= mean <= most + error else '<'}"


def row(name: str, found: list[Trial]) -> str:
    """One line of the table."""
    right = [trial for trial in found if not trial.mistake]
    line = f"{name:22} {len(found):4d} {len(found) - len(right):5d} |"
    if not right:
        return line
    ratios = np.array([joint for trial in right for joint in trial.ratios])
    inside = np.array([joint for trial in right for joint in trial.inside])
    image, chance, pose = ratios.T
    wrong, unsaid = (sum(getattr(trial, what) > 0 for trial in right) for what in ("wrong", "unsaid"))
    regions = " ".join(share(values, *WANTED_INSIDE) for values in inside.T[:3])
    by_chance = " ".join(share(values, 0.0) for values in inside.T[3:])
    return (
        f"{line}{np.median(image):6.3f} {share(image <= WITHIN, WANTED_SHARE)} {share(chance <= WITHIN, 0.0)} "
        f"{share(image <= WITHIN * chance, WANTED_SHARE)}|{np.nanmedian(pose):6.3f}|"
        f"{wrong:4d} {unsaid:5d}{'<' if unsaid else ' '}|{regions}|{by_chance}"
    )


def main() -> None:
    """Print a row for each kind of scene."""
    show_rows(__doc__, HEAD, ROWS, run, row, faults)


def faults(found: list[Trial]) -> Iterator[str]:
    """A line for each run with a fault."""
    for k, trial in enumerate(found):
        worst = max((a / b for a, b, _ in trial.ratios), default=0.0)
        if trial.mistake or trial.wrong or worst > WITHIN:
            minima = (
                f"{trial.wrong} frames in another minimum, {trial.unsaid} unsaid, worst ratio {worst:.2f} of chance"
            )
            said = "warned" if trial.said else "not warned"
            yield f"trial {k}: {f'{trial.mistake} ({said})' if trial.mistake else minima}"


if __name__ == "__main__":
    main()
