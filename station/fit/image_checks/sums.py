"""Sums of information and score over time, with what each frame's own numbers can do taken out.

With Z the whitened derivatives of a frame's corners, by its states s and by everything else, what is left of them after
the best change of the states is Z - Z_s (Z_s^T Z_s)^-1 Z_s^T Z (the Schur complement). Frames are summed in ticks of
time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.image.image_fit import ImageFit
from station.fit.image.views import COORDINATES
from station.fit.image_checks.directions import (
    CAMERA,
    CAMERA_COLUMNS,
    TWIST,
    Rows,
    T_part_marker,
)
from station.fit.image_checks.freedoms import Freedoms
from station.fit.image_checks.weighing import COMMON_SHARE
from station.kinematics import se3
from station.logs import FloatArray

IntArray = NDArray[np.intp]

# Times at which a change is looked for.
MOST_TICKS = 1000
# Frames at a time: some tens of MB.
CHUNK = 128
# A direction that has less than this share of the information of others says nothing.
NOTHING = 1e-11


@dataclass(frozen=True, eq=False)
class Sums:
    """Information and scores of n ticks: D columns of what may be wrong, and P of what a fit does about it.

    Attributes:
        columns: of each way to be wrong, among the D.
        start_s, end_s: (n,) times of a tick's first and last frame.
        tick: (T,) that each frame is in.
        DD: (n, D, D).
        DP: (n, D, p), by the first p of the P: those that the fit has by itself.
        Dr: (n, D) gradients of the fit to the residuals.
        detector: (n, M) variance of the detector's own errors of a coordinate, summed over a marker's sightings.
        PP: (P, P) over all ticks.
        Pr: (P,).
        added: which of the D are among the P too, in this order, each with its profile (n,) over the ticks.
    """

    columns: Mapping[str, slice]
    start_s: FloatArray
    end_s: FloatArray
    tick: IntArray
    DD: FloatArray
    DP: FloatArray
    Dr: FloatArray
    detector: FloatArray
    PP: FloatArray
    Pr: FloatArray
    added: tuple[tuple[slice, FloatArray], ...] = ()

    def by_fit(self, what: str) -> FloatArray:
        """(n, d, P) information about both one way to be wrong, of `columns`, and each thing that a fit does."""
        c = self.columns[what]
        by_added = [self.DD[:, c, other] * profile[:, None, None] for other, profile in self.added]
        return np.concatenate([self.DP[:, c], *by_added], axis=-1)

    def allowing(self, what: str, profile: FloatArray, std: FloatArray | None = None, towards: float = 0.0) -> Sums:
        """The same with a fit that may also change something by a profile (n,) over time.

        Args:
            what: of `columns`.
            profile: over the ticks.
            std: (d,) how well the change is known before, none of it 0; None for not at all.
            towards: change that is expected then.
        """
        c = self.columns[what]
        by_P = np.einsum("t,tdp->dp", profile, self.by_fit(what))
        known = np.zeros(c.stop - c.start) if std is None else 1.0 / std**2
        own = np.einsum("t,tde->de", profile**2, self.DD[:, c, c]) + np.diag(known)
        pull = np.einsum("t,td->d", profile, self.Dr[:, c]) + known * towards
        return replace(
            self,
            PP=np.block([[self.PP, by_P.T], [by_P, own]]),
            Pr=np.concatenate([self.Pr, pull]),
            added=(*self.added, (c, profile)),
        )


def sums(image: ImageFit, rows: Rows, free: Freedoms) -> Sums:
    """All sums that the tests are made of."""
    views = image.views
    frames, M = len(views.t_s), len(views.marker_id)
    columns = _columns(image)
    D, numbers = max((c.stop for c in columns.values()), default=0), free.by_parameters.shape[-1]
    P = numbers + COORDINATES * (int(rows.look.max(initial=-1)) + 1)
    tick = (np.arange(frames) * min(frames, MOST_TICKS)) // max(frames, 1)
    n = int(tick[-1]) + 1 if frames else 0
    DD, DP, Dr, Pr = np.zeros((n, D, D)), np.zeros((n, D, P)), np.zeros((n, D)), np.zeros(P)
    # Long looks' errors are known before to be of this deviation.
    PP: FloatArray = np.zeros((P, P))
    looks = np.arange(numbers, P, dtype=np.intp)
    PP[looks, looks] = 1.0 / COMMON_SHARE
    for first in range(0, frames, CHUNK):  # all at once would take gigabytes
        last = min(first + CHUNK, frames)
        some = slice(*np.searchsorted(views.frame[rows.rows], [first, last]).tolist())
        gram = _projected(*_stacked(image, rows, some, first, last - first, M, free, columns, D, P))
        at = tick[first:last]
        np.add.at(DD, at, gram[:, :D, :D])
        np.add.at(DP, at, gram[:, :D, D : D + P])
        np.add.at(Dr, at, gram[:, :D, -1])
        np.add(PP, gram[:, D : D + P, D : D + P].sum(axis=0), out=PP)
        Pr += gram[:, D : D + P, -1].sum(axis=0)
    detector = np.zeros((n, M))
    np.add.at(detector, (tick[views.frame[rows.rows]], views.marker[rows.rows]), rows.detector)
    begins = np.flatnonzero(np.diff(tick, prepend=-1))
    ends = np.append(begins[1:], frames) - 1
    return Sums(columns, views.t_s[begins], views.t_s[ends], tick, DD, DP, Dr, detector, PP, Pr)


def marker_name(marker: int) -> str:
    """The name of a marker's move among the ways to be wrong."""
    return f"marker {marker}"


def part_name(part: int) -> str:
    """The name of a part's move among the ways to be wrong."""
    return f"part {part}"


def scene_centre(image: ImageFit) -> FloatArray:
    """(3,) m in the camera: where the parts are, about."""
    return np.nan_to_num(np.nanmedian(image.T_ref_part[..., :3, 3].reshape(-1, 3), axis=0))


def _columns(image: ImageFit) -> dict[str, slice]:
    """A twist for each marker, for each part of several markers, and for all that is seen; then the camera's numbers.

    That of all that is seen is along the camera's axes and about its middle: about the camera's own centre, hardly any
    object could tell a turn from a shift.
    """
    views = image.views
    counts = np.bincount(views.part, minlength=len(views.parts))
    names = [marker_name(m) for m in range(len(views.marker_id))]
    names += [part_name(k) for k in np.flatnonzero(counts > 1).tolist()]
    found = {name: slice(TWIST * i, TWIST * (i + 1)) for i, name in enumerate([*names, CAMERA])}
    start = TWIST * len(found)
    return found | {name: slice(start + c.start, start + c.stop) for name, c in CAMERA_COLUMNS.items()}


def _stacked(
    image: ImageFit,
    rows: Rows,
    some: slice,
    first: int,
    frames: int,
    M: int,
    free: Freedoms,
    columns: Mapping[str, slice],
    D: int,
    P: int,
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of each frame's corners (frames, 8 M, C) by all but the states, and (frames, 8 M, s) by these."""
    views, chosen = image.views, rows.rows[some]
    frame, marker = views.frame[chosen], views.marker[chosen]
    part, by_pose = views.part[marker], rows.by_pose[some]
    numbers, s = free.by_parameters.shape[-1], free.by_states.shape[-1]
    Z = np.zeros((len(chosen), COORDINATES, D + P + 1))
    centre = scene_centre(image)
    mount = by_pose @ se3.adjoint(T_part_marker(views.points_m))[marker]
    for name, c in columns.items():
        if name in CAMERA_COLUMNS:
            Z[:, :, c] = rows.by_camera[some][:, :, CAMERA_COLUMNS[name]]
        elif name == CAMERA:
            Z[:, :, c] = by_pose @ se3.adjoint(se3.inverse(image.T_ref_part[frame, part]) @ se3.translation(centre))
        else:
            kind, number = name.split()
            own = (marker if kind == "marker" else part) == int(number)
            Z[own, :, c] = (mount if kind == "marker" else by_pose)[own]
    Z[:, :, D : D + numbers] = by_pose @ free.by_parameters[frame, part]
    in_look = np.flatnonzero(rows.look[some] >= 0)
    first_column = D + numbers + COORDINATES * rows.look[some][in_look]
    for i in range(COORDINATES):  # the error that all pictures of a look share, in units of its deviation
        Z[in_look, i, first_column + i] = np.sqrt(rows.share[some][in_look])
    Z[:, :, -1] = rows.residual[some]
    S = by_pose @ free.by_states[frame, part]
    usable = np.isfinite(Z).all(axis=(1, 2)) & np.isfinite(S).all(axis=(1, 2))
    at = (frame[usable] - first, marker[usable])
    by_rest, by_states = np.zeros((frames, M, COORDINATES, D + P + 1)), np.zeros((frames, M, COORDINATES, s))
    by_rest[at], by_states[at] = Z[usable], S[usable]
    return by_rest.reshape(frames, -1, D + P + 1), by_states.reshape(frames, -1, s)


def change_of_states(
    image: ImageFit,
    rows: Rows,
    free: Freedoms,
    allowed: Sums,
    numbers: FloatArray,
    added: Sequence[tuple[str, FloatArray]],
) -> FloatArray:
    """(T, s) by which the states follow when all other numbers change.

    Args:
        image: that the sums are of.
        rows: of it.
        free: its freedoms.
        allowed: sums of the fit that may change all of `numbers`.
        numbers: (P,) changes: of the parameters, of the long looks' errors, then of what was added.
        added: names and profiles (n,) of what was allowed for, in that order.
    """
    frames, M, D = len(image.views.t_s), len(image.views.marker_id), allowed.DD.shape[-1]
    widths = [allowed.columns[what].stop - allowed.columns[what].start for what, _ in added]
    P = len(numbers) - sum(widths)
    found = np.zeros((frames, free.by_states.shape[-1]))
    for first in range(0, frames, CHUNK):
        last = min(first + CHUNK, frames)
        some = slice(*np.searchsorted(image.views.frame[rows.rows], [first, last]).tolist())
        Z, S = _stacked(image, rows, some, first, last - first, M, free, allowed.columns, D, P)
        left = Z[:, :, -1] - Z[:, :, D : D + P] @ numbers[:P]
        start = P
        for (what, profile), width in zip(added, widths, strict=True):
            by = Z[:, :, allowed.columns[what]] @ numbers[start : start + width]
            left = left - profile[allowed.tick[first:last], None] * by
            start += width
        found[first:last] = _best_states(S, left[..., None])[..., 0]
    return found


def _best_states(S: FloatArray, Z: FloatArray) -> FloatArray:
    """(F, s, C) changes of the states that explain columns Z (F, R, C) best; S (F, R, s) are their derivatives."""
    S_t = np.swapaxes(S, -1, -2)
    H = S_t @ S
    diagonal = np.arange(H.shape[-1], dtype=np.intp)
    size: FloatArray = np.sqrt(np.maximum(H[:, diagonal, diagonal], 1e-300))
    H_unit = H / size[:, :, None] / size[:, None, :]
    # Unseen states have no information: theirs is set to some, their gradient is nothing.
    H_unit[:, diagonal, diagonal] = 1.0 + NOTHING
    found = np.linalg.solve(H_unit, (S_t @ Z) / size[:, :, None]) / size[:, :, None]
    return np.asarray(found, dtype=np.float64)


def _projected(Z: FloatArray, S: FloatArray) -> FloatArray:
    """(F, C, C) products of what is left of columns Z (F, R, C) after the best change of the states, S (F, R, s)."""
    left = Z - S @ _best_states(S, Z)
    return np.swapaxes(left, -1, -2) @ left
