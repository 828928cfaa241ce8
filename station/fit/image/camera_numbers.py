"""What of the camera is estimated beside the tree: a shift of edges, its readout, its focal length."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from calibration.intrinsics import CameraModel
from station.errors import InvalidData
from station.logs import FloatArray

# Deviation of an edge shift of which nothing is known: blur through gamma makes tenths of a pixel.
UNKNOWN_SHIFT_PX = 1.0
# Of a readout that is to be estimated: it can take all of a frame, of any camera.
UNKNOWN_READOUT_S = 0.05
# Of a focal length whose calibration doesn't say how well it is known, as a share of it.
UNKNOWN_FOCAL = 0.01


@dataclass(frozen=True)
class CameraNumbers:
    """What the camera does to all corners alike.

    Attributes:
        edge_shift_px: by which dark squares' edges are seen outward of where they are.
        focal: factor on both focal lengths of the calibration.
        readout_s: time from the first to the last row of a rolling shutter.
    """

    edge_shift_px: float = 0.0
    focal: float = 1.0
    readout_s: float = 0.0


NUMBERS = tuple(field.name for field in fields(CameraNumbers))


@dataclass(frozen=True)
class Unknowns:
    """Which of the camera's numbers are estimated, where they start, and how well they are known before.

    Attributes:
        names: of `CameraNumbers`, those that are estimated.
        given: all of them, as the calibration has them.
        prior_std: of each that is estimated.

    Raises:
        InvalidData: for a name that is none, or one that is there twice.
    """

    names: tuple[str, ...]
    given: CameraNumbers
    prior_std: tuple[float, ...]

    def __post_init__(self) -> None:
        wrong = [name for name in self.names if name not in NUMBERS]
        if wrong or len(set(self.names)) != len(self.names):
            what = f"'{wrong[0]}' is none" if wrong else "one is there twice"
            raise InvalidData(f"numbers of the camera: {what} in {', '.join(self.names)}; have {', '.join(NUMBERS)}")

    @property
    def start(self) -> FloatArray:
        """(E,) values that the estimate starts from; their priors are about them."""
        return np.array([getattr(self.given, name) for name in self.names], dtype=np.float64)

    def at(self, values: FloatArray) -> CameraNumbers:
        """All numbers, with those that are estimated at values (E,)."""
        found = {name: getattr(self.given, name) for name in NUMBERS}
        return CameraNumbers(**(found | {name: float(x) for name, x in zip(self.names, values, strict=True)}))

    def stds(self, deviations: FloatArray) -> CameraNumbers:
        """Standard deviations (E,) by name; NaN of what was not estimated."""
        found = dict.fromkeys(NUMBERS, np.nan)
        return CameraNumbers(**(found | {name: float(x) for name, x in zip(self.names, deviations, strict=True)}))


def unknowns(camera: CameraModel, readout_s: float, names: tuple[str, ...] = ("edge_shift_px",)) -> Unknowns:
    """What is to be estimated of a camera, with its calibration for a prior.

    Args:
        camera: its edge shift, and the deviations of its focal lengths, are the priors.
        readout_s: of its rolling shutter; 0 for none.
        names: of `CameraNumbers`.
    """
    given = CameraNumbers(edge_shift_px=camera.edge_shift_px or 0.0, readout_s=readout_s)
    prior = {
        "edge_shift_px": camera.edge_shift_std_px or UNKNOWN_SHIFT_PX,
        "focal": focal_std(camera),
        "readout_s": UNKNOWN_READOUT_S,
    }
    return Unknowns(tuple(names), given, tuple(prior.get(name, np.nan) for name in names))


def focal_std(camera: CameraModel) -> float:
    """Deviation of the calibrated focal lengths, as a share of them: they err together, for the most part."""
    if camera.matrix_std is None:
        return UNKNOWN_FOCAL
    return float(np.mean(camera.matrix_std[[0, 1], [0, 1]] / camera.matrix[[0, 1], [0, 1]])) or UNKNOWN_FOCAL
