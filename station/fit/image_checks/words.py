"""Findings as sentences, with sizes, units and times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from station.fit.image.image_fit import ImageFit
from station.fit.image.views import COORDINATES
from station.fit.image_checks.changes import Effect
from station.fit.image_checks.directions import CAMERA, EDGES, FOCAL, PLACE, TILT, Rows
from station.fit.image_checks.findings import UNITS, Finding, Size
from station.logs import FloatArray

# Sizes below this many deviations aren't told beside one that is above.
TOLD = 3.0
SURE = 5.0
# A gap between two frames is as likely anywhere within.
UNIFORM = 12**-0.5


@dataclass(frozen=True, eq=False)
class About:
    """What findings are told of."""

    image: ImageFit
    rows: Rows


def told(about: About, kind: str, effect: Effect, p_value: float, or_else: Sequence[str]) -> Finding:
    """A finding of one way to be wrong.

    Args:
        about: the fit that is tested.
        kind: as in `Finding`.
        effect: of the test.
        p_value: after all tests.
        or_else: names of what explains as much.
    """
    others = tuple(dict.fromkeys(_named(about, name) for name in or_else if name != effect.what))
    sizes, said = _SAID[kind](about, effect)
    marker_id, part = _whose(about, effect.what)
    t_s, t_std_s = (None, None) if not len(effect.times) else _time(about, effect)
    subject = _named(about, effect.what)
    at = "" if t_s is None or t_std_s is None else f" at t = {_with_std(t_s, t_std_s)} s"
    text = said.format(subject=subject, at=at, sizes=" and ".join(map(str, sizes)))
    if others:
        names = " or ".join(others)
        text += f", or {names} did" if len(effect.times) else f"; {names} would explain it as well"
    return Finding(kind, text, sizes, p_value, marker_id, part, t_s, t_std_s, others)


def _whose(about: About, what: str) -> tuple[int | None, str | None]:
    """The marker's id and the part that something is about."""
    views = about.image.views
    kind, _, number = what.partition(" ")
    if kind == "marker":
        marker = int(number)
        return int(views.marker_id[marker]), views.parts[int(views.part[marker])]
    return None, views.parts[int(number)] if kind == "part" else None


def _named(about: About, what: str) -> str:
    views = about.image.views
    kind, _, number = what.partition(" ")
    if kind == "marker":
        return f"marker {views.marker_id[int(number)]}"
    return f"the markers of {views.parts[int(number)]}" if kind == "part" else _CAMERA_NAMES[kind]


def _with_std(value: float, std: float) -> str:
    digits = int(np.clip(1 - np.floor(np.log10(max(std, 1e-6))), 0, 3))
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def _time(about: About, effect: Effect) -> tuple[float, float]:
    """When a change came, and its standard deviation: over all times, and within the gap between two ticks."""
    before, after = effect.gap_s
    middle, weight = 0.5 * (before + after), effect.times
    mean = float(weight @ middle)
    variance = float(weight @ ((middle - mean) ** 2 + (UNIFORM * (after - before)) ** 2))
    return mean, float(np.sqrt(variance))


def _length(values: FloatArray, covariance: FloatArray, unit: str) -> Size:
    length = float(np.linalg.norm(values))
    along = values / length if length > 0 else np.array([1.0, 0.0, 0.0])
    return Size(UNITS[unit] * length, unit, UNITS[unit] * float(np.sqrt(along @ covariance @ along)))


def _twist(effect: Effect) -> tuple[Size, ...]:
    """The distance and the angle of a move; that which is there, if one isn't."""
    sizes = (
        _length(effect.size[:3], effect.covariance[:3, :3], "mm"),
        _length(effect.size[3:], effect.covariance[3:, 3:], "deg"),
    )
    sure = tuple(size for size in sizes if size.value > TOLD * size.std)
    return sure or (max(sizes, key=lambda size: size.value / size.std),)


def is_large(effect: Effect) -> bool:
    """Whether a move is so large, in its deviations, that its distance or its angle alone says so."""
    return any(size.value > SURE * size.std for size in _twist(effect))


def _moved(about: About, effect: Effect) -> tuple[tuple[Size, ...], str]:
    views = about.image.views
    kind, _, number = effect.what.partition(" ")
    if kind == "marker":
        where = f" on {views.parts[views.part[int(number)]]}"
    elif kind == "part":
        where = ", all alike,"
    else:
        return _twist(effect), "{subject} moved{at}: all that it sees lies {sizes} off from then on"
    return _twist(effect), "{subject}" + where + " moved{at} by {sizes}"


def _drifted(about: About, effect: Effect) -> tuple[tuple[Size, ...], str]:
    return _twist(effect), "{subject} drifted: at the end all that it sees lies {sizes} from where it was"


def _one(effect: Effect, unit: str) -> Size:
    return Size(UNITS[unit] * float(effect.size[0]), unit, UNITS[unit] * float(np.sqrt(effect.covariance[0, 0])))


def _focal(about: About, effect: Effect) -> tuple[tuple[Size, ...], str]:
    size = _one(effect, "%")
    by = abs(size.value) / size.std
    stated = "" if about.image.views.camera.matrix_std is not None else ", whose deviation isn't stated and taken as 1%"
    ahead = f"{size.value:+.3g}%"
    return (size,), f"the focal length disagrees with the calibration by {by:.1f} sigma ({ahead}{stated})"


def _focal_drift(about: About, effect: Effect) -> tuple[tuple[Size, ...], str]:
    return (_one(effect, "%"),), "the focal length drifted over the session by {sizes}"


def _edges(about: About, effect: Effect) -> tuple[tuple[Size, ...], str]:
    size = _one(effect, "px")
    by = abs(size.value) / size.std
    return (size,), f"the edge shift disagrees with the calibration by {by:.1f} sigma ({{sizes}})"


def _place(about: About, effect: Effect) -> tuple[tuple[Size, ...], str]:
    """By the RMS of the corners' displacement that nothing else can do."""
    per_corner = about.rows.sigma_px / np.sqrt(COORDINATES * max(about.rows.pictures, 1.0))
    rms = per_corner * np.sqrt(float(effect.size @ effect.information @ effect.size))
    size = Size(float(rms), "px", float(per_corner * np.sqrt(effect.noise)))
    return (size,), "residuals depend on the place in the image, {sizes} RMS: the lens model or its numbers are wrong"


def _tilt(about: About, effect: Effect) -> tuple[tuple[Size, ...], str]:
    size = _one(effect, "px")
    return (size,), "residuals depend on tilt: markers seen at 60 deg have their edges {sizes} farther out"


_CAMERA_NAMES = {
    CAMERA: "the camera",
    EDGES: "the edge shift",
    FOCAL: "the focal length",
    PLACE: "a lens model of other numbers",
    TILT: "an edge shift that depends on tilt",
}
_SAID = {
    "marker": _moved,
    "part": _moved,
    "camera": _moved,
    "camera_drift": _drifted,
    "focal": _focal,
    "focal_drift": _focal_drift,
    "edges": _edges,
    "place": _place,
    "tilt": _tilt,
}
