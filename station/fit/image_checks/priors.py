"""What the camera's calibration says of its numbers, against what the corners say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from station.fit.image.camera_numbers import focal_std
from station.fit.image.image_fit import ImageFit
from station.fit.image.views import COORDINATES
from station.fit.image_checks.changes import Effect, as_chi2
from station.fit.image_checks.directions import EDGES, FOCAL, LENS, PLACE, TILT, Rows
from station.fit.image_checks.sums import Sums
from station.logs import FloatArray

# Detectors err by this with the place in the image and with tilt, px, whatever the lens: no finding. On rendered
# pictures, whose lens is exact, 0.0005 to 0.0008 px RMS were seen by place, and nothing by tilt.
PLACE_FLOOR_PX, TILT_FLOOR_PX = 0.003, 0.01


def against_calibration(
    image: ImageFit, rows: Rows, effect: Effect, log_chance: Callable[[float, int], float]
) -> Effect:
    """The same effect as a difference to the calibration, which has a covariance of its own.

    The numbers that a fit estimated pull towards the calibration; what the corners say by themselves is their value and
    the step that the scores ask for.
    """
    given = calibrated_covariance(image, effect.what) + _floor(rows, effect)
    size = effect.size + _estimated(image, effect.what)
    gain = float(size @ np.linalg.solve(effect.covariance + given, size))
    explained = float(size @ effect.information @ size)
    log_p = log_chance(as_chi2(gain, effect.freedom), effect.directions)
    covariance = effect.covariance + given
    return replace(effect, size=size, covariance=covariance, gain=gain, explained=explained, log_p=log_p)


def _floor(rows: Rows, effect: Effect) -> FloatArray:
    """(d, d) covariance of what detectors make by themselves."""
    if effect.what == TILT:
        return np.array([[TILT_FLOOR_PX**2]])
    if effect.what == PLACE:
        corners = COORDINATES * rows.pictures * (PLACE_FLOOR_PX / rows.sigma_px) ** 2
        return corners / LENS * effect.covariance / effect.noise
    return np.zeros((1, 1))


def calibration_allowed(base: Sums, image: ImageFit, but: str = "") -> tuple[Sums, list[tuple[str, FloatArray]]]:
    """The sums of a fit that may change the camera's numbers as far as the calibration leaves them open, all but one.

    An edge shift may be anything: what blur does to it is no calibration's. Lens coefficients whose deviations aren't
    stated are taken for exact. With the names and profiles (n,) of what was allowed for.
    """
    ones = np.ones(len(base.start_s))
    added: list[tuple[str, FloatArray]] = []
    for what in (EDGES, FOCAL, PLACE):
        std = np.sqrt(np.diag(calibrated_covariance(image, what)))
        if what == but or (what != EDGES and not np.all(std > 0)):
            continue
        known = (None, 0.0) if what == EDGES else (std, -_estimated(image, what))
        base = base.allowing(what, ones, *known)
        added.append((what, ones))
    return base, added


def calibrated_covariance(image: ImageFit, what: str) -> FloatArray:
    """(d, d) of the calibration's numbers; nothing where it doesn't tell, but for the focal length."""
    camera = image.views.camera
    if what == TILT:
        return np.zeros((1, 1))
    if what == EDGES:
        return np.array([[(camera.edge_shift_std_px or 0.0) ** 2]])
    if what == PLACE:
        std = np.zeros(LENS) if camera.distortion_std is None else camera.distortion_std[:LENS]
        return np.diag(std**2)
    return np.array([[focal_std(camera) ** 2]])


def _estimated(image: ImageFit, what: str) -> float:
    """By how much the fit's own value differs from the calibration's."""
    if what == FOCAL:
        return image.numbers.focal - 1.0
    if what == EDGES:
        return image.numbers.edge_shift_px - (image.views.camera.edge_shift_px or 0.0)
    return 0.0
