"""Flips: how often the wrong one of a marker's two poses is taken, in rendered sweeps seen by the real detector.

A marker of 50 mm at 0.6 m (50 px) and, where flips are common, at 1.2 m; sweeps through tilts from 0 to 60 deg and
through the front, and standing still at small tilts. A flip is a frame whose other candidate is clearly nearer to the
truth: by more than 0.3 of what the two are apart, and they are more than 3 of the chosen one's standard deviations
apart; nearer pairs differ by noise alone. Counted where the corners of the frame alone choose, where the whole log
chooses, and of the latter those that are not flagged ambiguous.

Run: python -m tests.benchmarks.flips [--quick]
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from station.kinematics import se3
from station.logs import FloatArray
from station.tracking import TrackedParts, track_parts
from tests.benchmarks.arguments import parser, trials_of
from tests.benchmarks.watched_marker import CAMERA, FPS, TABLE, observed
from tests.rendered_markers import facing

DISTANCES_M = (0.6, 1.2)
FRAMES = 150
CLEARLY = 0.3
APART_SIGMAS = 3.0
# Must not flip from this tilt on.
FROM_DEG = 3.0


def sway(t_s: FloatArray) -> FloatArray:
    """(F, 3), in distances: the marker isn't always in the middle, and its edges cross the pixels."""
    return np.stack([0.08 * np.sin(0.7 * t_s), 0.07 * np.cos(0.9 * t_s), 1 + 0 * t_s], axis=-1)


def still(t_s: FloatArray) -> FloatArray:
    """(F, 3), in distances."""
    return np.broadcast_to((0.052, -0.037, 1.0), (len(t_s), 3))


Sweep = Callable[[FloatArray], FloatArray]
# Tilts (F,) [deg] over the time [s], and where the marker is.
SWEEPS: dict[str, tuple[Sweep, Sweep]] = {
    "0 to 60": (lambda t: 60 * t / t[-1], sway),
    "60 to 0": (lambda t: 60 - 60 * t / t[-1], sway),
    "through the front, 30 deg/s": (lambda t: -60 + 30 * t, sway),
    "through the front, 8 deg/s": (lambda t: -20 + 8 * t, sway),
    "to the front and back": (lambda t: 20 * np.abs(1 - 2 * t / t[-1]), sway),
    "swinging, 15 deg": (lambda t: 15 * np.cos(3 * t), sway),
    **{f"at {tilt} deg, moving": (lambda t, tilt=tilt: tilt + 0 * t, sway) for tilt in (0, 1, 3, 5, 8)},
    **{f"at {tilt} deg, still": (lambda t, tilt=tilt: tilt + 0 * t, still) for tilt in (0, 1, 3, 5, 8)},
}


def flipped(tracked: TrackedParts, chosen: np.ndarray, truth: FloatArray) -> np.ndarray:
    """(F,) whether the candidate that wasn't chosen is clearly nearer to the truth (F, 4, 4)."""
    R = tracked.hypotheses.T_cam_part[:, 0, :, :3, :3]
    off = se3.angle(np.swapaxes(truth[:, None, :3, :3], -1, -2) @ R)
    rows, between = np.arange(len(R)), se3.log_so3(np.swapaxes(R[:, 0], -1, -2) @ R[:, 1])
    spread = tracked.hypotheses.covariance[rows, 0, chosen, 3:, 3:]
    sigmas = np.sqrt(np.einsum("ni,nij,nj->n", between, np.linalg.inv(spread), between))
    nearer = off[rows, chosen] - off[rows, 1 - chosen] > CLEARLY * np.linalg.norm(between, axis=-1)
    return nearer & (sigmas > APART_SIGMAS)  # NaN compares false


def sweep(name: str, distance_m: float, seed: int) -> np.ndarray:
    """(6, F) tilt; seen; flips by the frame alone, over time, and over time unflagged; flagged."""
    rng = np.random.default_rng((seed, list(SWEEPS).index(name)))
    t_s = np.arange(FRAMES) / FPS
    tilt, place = SWEEPS[name]
    azimuth, spin = rng.uniform(0, 2 * np.pi, 2)
    truth = facing(np.deg2rad(tilt(t_s)), azimuth + 0 * t_s, spin + 0 * t_s, distance_m * place(t_s))
    tracked = track_parts(observed(truth, seed=seed), TABLE, CAMERA)
    chosen, flagged = tracked.choice.chosen[:, 0], tracked.choice.ambiguous[:, 0]
    alone, over_time = flipped(tracked, 0 * chosen, truth), flipped(tracked, chosen, truth)
    return np.stack([np.abs(tilt(t_s)), tracked.hypotheses.seen[:, 0], alone, over_time, over_time & ~flagged, flagged])


def row(name: str, found: np.ndarray) -> str:
    """Counts of the frames, in all and from FROM_DEG on."""
    cells = []
    for rows in (found, found[:, found[0] >= FROM_DEG - 1e-9]):
        seen = rows[1].sum()
        counts = [int(n) for n in rows[2:].sum(axis=1)]
        cells.append(
            f"{int(seen):6}  {counts[0]:6}  {counts[1]:6}  {counts[2]:8}  {100 * counts[3] / max(seen, 1):6.1f} %"
        )
    return f"{name:28}  " + "   |".join(cells)


def main() -> None:
    """Print a row a sweep: in all frames, and in those from 3 deg on."""
    options = parser(__doc__, trials=2, quick=1).parse_args()
    head = "frames   alone  chosen  unflagged  flagged"
    for distance_m in DISTANCES_M:
        print(f"\n{f'sweep at {distance_m:g} m':28}  {head}   |{head}, from {FROM_DEG:g} deg")
        everything = []
        for name in SWEEPS:
            runs = [sweep(name, distance_m, options.seed + k) for k in range(trials_of(options))]
            everything.append(np.concatenate(runs, axis=1))
            print(row(name, everything[-1]), flush=True)
        print(row("all", np.concatenate(everything, axis=1)))


if __name__ == "__main__":
    main()
