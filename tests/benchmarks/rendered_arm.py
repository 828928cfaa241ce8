"""The demo's arm in smooth motion before a rendered camera, without a servo bus: pictures whose truth is exact.

Of each seed its own: blur, noise, gamma (of which the detector knows nothing), the JPEG's quality, the motion, and
where plates and camera are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray
from station.perception.markers import MarkerTable
from station.perception.observations import ObservationLog
from station.rig import load_rig
from station.stage import Stage
from station.tracking import observe_frames
from tests.benchmarks.rendered_truth import Truth

RIG = "demo"
FPS, FRAMES = 30.0, 300
# Lowest and highest state of each joint [deg], and how many times it goes to and fro in ten seconds.
RANGES_DEG = {"base_pan": (-50, 50), "shoulder": (-20, 30), "elbow": (-45, -5), "wrist": (-40, 40)}
CYCLES = {"base_pan": (1.0, 1.5), "shoulder": (1.0, 2.0), "elbow": (1.5, 2.5), "wrist": (1.5, 2.5)}
BLUR_PX, NOISE_GREY, GAMMA, JPEG_QUALITY = (0.5, 0.9), (1.0, 3.0), (2.0, 2.4), (85, 96)


@dataclass(frozen=True, eq=False)
class RenderedArm:
    """What was seen, by which markers and camera, and the truth."""

    observations: ObservationLog
    table: MarkerTable
    truth: Truth


def smooth_motion(joints: tuple[str, ...], rng: np.random.Generator) -> Callable[[FloatArray], FloatArray]:
    """States (..., J) [rad] at times (...): each joint's own sinusoid within its range."""
    low, high = np.radians([RANGES_DEG[name] for name in joints]).T
    rate = 2 * np.pi * rng.uniform(*np.array([CYCLES[name] for name in joints]).T) / 10.0
    phase = rng.uniform(0, 2 * np.pi, len(joints))
    return lambda t_s: (low + high) / 2 + (high - low) / 2 * np.sin(rate * t_s[..., None] + phase)


def rendered_arm(seed: int, *, frames: int = FRAMES, readout_s: float = 0.0, plain: bool = False) -> RenderedArm:
    """The arm of a seed, rendered and detected.

    Args:
        seed: of everything random.
        frames: a thirtieth of a second apart.
        readout_s: of the shutter.
        plain: as the demo's camera is, and without JPEG.
    """
    rng = np.random.default_rng((seed, 8))
    rig = load_rig(RIG)
    simulation = rig.table.simulation
    assert simulation is not None
    blur_px, noise_grey, gamma = (float(rng.uniform(*of)) for of in (BLUR_PX, NOISE_GREY, GAMMA))
    quality = int(rng.integers(*JPEG_QUALITY))
    looks = {} if plain else {"blur_px": blur_px, "noise_grey": noise_grey, "gamma": gamma}
    camera = simulation.camera.model_copy(update={"readout_s": readout_s, **looks})
    stage = Stage(rig.table, simulation.model_copy(update={"camera": camera}), rig.camera_model, seed)
    motion = smooth_motion(stage.joints, rng)
    shares = (np.arange(camera.blur_instants) + 0.5) / camera.blur_instants - 0.5
    offsets_s = shares[:, None] * camera.exposure_s + stage.knots_s

    def pictures() -> Iterator[tuple[float, NDArray[np.uint8]]]:
        for index in range(frames):
            picture = stage.render(motion(index / FPS + offsets_s), index)
            yield index / FPS, picture if plain else as_jpeg(picture, quality)

    table = rig.table.marker_table()
    observations = observe_frames(pictures(), table, rig.camera_model)
    return RenderedArm(observations, table, Truth(stage, motion, rig.camera_model, readout_s))


def as_jpeg(picture: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """What is left of a picture (H, W, 3) after a camera has sent it as a JPEG."""
    done, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_COLOR), dtype=np.uint8)
