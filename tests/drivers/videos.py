"""Video files and image folders written for tests, frame k flat grey 10 k (of 256)."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

SIZE = (64, 48)
FRAMES = 20


def flat(k: int, size_px: tuple[int, int] = SIZE) -> np.ndarray:
    return np.full((size_px[1], size_px[0], 3), 10 * k % 256, dtype=np.uint8)


def textured(k: int, size_px: tuple[int, int] = SIZE) -> np.ndarray:
    """A frame that no codec makes small, so that a part of the file is a part of the frames."""
    return np.random.default_rng(k).integers(0, 256, (size_px[1], size_px[0], 3), dtype=np.uint8)


def write_video(path: Path, fps: float = 100.0, frames: int = FRAMES, codec: str = "MJPG", picture=flat) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), fps, SIZE)
    assert writer.isOpened()
    for k in range(frames):
        writer.write(picture(k))
    writer.release()
    return path


def write_images(folder: Path, names: list[str]) -> Path:
    folder.mkdir(exist_ok=True)
    for k, name in enumerate(names):
        cv2.imwrite(str(folder / name), flat(k))
    return folder
