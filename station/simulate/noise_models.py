"""The models of noise by name; the one place to add another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

from station.errors import InvalidData
from station.simulate.camera_noise import CameraNoise
from station.simulate.noise import GaussianNoise, Noise, StudentNoise, UniformNoise

NOISE_MODELS: dict[str, type[Noise]] = {
    model.name: model for model in (UniformNoise, GaussianNoise, StudentNoise, CameraNoise)
}


def make_noise(
    name: str, translation_m: float, rotation_rad: float, more: Mapping[str, float | None] | None = None
) -> Noise:
    """A model of `NOISE_MODELS` with its magnitudes and, by name, what else it can be told; None leaves a default.

    Raises:
        InvalidData: for a name that is none, and what the model doesn't have.
    """
    if name not in NOISE_MODELS:
        raise InvalidData(f"noise '{name}' is unknown; choose one of {', '.join(NOISE_MODELS)}")
    model = NOISE_MODELS[name]
    told = {key: value for key, value in (more or {}).items() if value is not None}
    known = [field.name for field in fields(model)][2:]
    for key in told:
        if key not in known:
            those = [other for other, made in NOISE_MODELS.items() if key in {f.name for f in fields(made)}]
            raise InvalidData(f"{name} noise has no {key}; {', '.join(those) or 'no'} noise has one")
    return model(translation_m, rotation_rad, **told)
