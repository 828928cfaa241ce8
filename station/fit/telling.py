"""What a tree's file tells of how the tree was found."""

from __future__ import annotations

from dataclasses import asdict

from station.fit.image.image_fit import ImageFit
from station.fit.options import FitOptions


def method_told(options: FitOptions, image: ImageFit | None, *, root_static: bool) -> dict[str, object]:
    """As JSON values: options; what the tree was refined on; whether its root stands still, in words; and, of corners,
    the camera's numbers with their standard deviations, which are NaN of those that were not estimated.
    """
    told: dict[str, object] = {
        "name": options.method,
        "criterion": options.criterion,
        "joint_types": list(options.joint_types),
        "refine": "image" if image is not None else "none" if options.refine == "none" else "pose",
        "root": "static" if root_static else "moving",
    }
    if image is not None:
        std = asdict(image.numbers_std)
        told["camera"] = {name: {"value": value, "std": std[name]} for name, value in asdict(image.numbers).items()}
    return told
