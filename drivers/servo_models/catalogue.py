"""The models that there are, by name and by model number; a file is read when its model is first asked for."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from drivers.errors import DriverError
from drivers.servo_models.model import ServoModel

MX2_SUFFIX = "(2.0)"  # ends the names of MX servos with protocol 2.0 firmware; their files end in _2, as the manual's


def _name(stem: str) -> str:
    base, _, end = stem.upper().rpartition("_")
    return base.replace("_", "-") + MX2_SUFFIX if end == "2" else stem.upper().replace("_", "-")


def _stems() -> dict[str, str]:
    """Model name -> file stem; a model is added by adding its file."""
    found = sorted(entry.name for entry in (files(__package__ or "") / "models").iterdir())
    stems = [name.removesuffix(".toml") for name in found if name.endswith(".toml")]
    return {_name(stem): stem for stem in stems}


_STEMS = _stems()
MODELS: tuple[str, ...] = tuple(_STEMS)


def load_model(name: str, *, protocol: float | None = None) -> ServoModel:
    """The model of that name.

    Args:
        name: as printed on the servo ("AX-18A"), without a suffix for the connector.
        protocol: that it must speak. Of an MX servo, whose two firmwares have tables and model numbers of their own,
            the model that speaks it is returned: "MX-28" with 2.0 is "MX-28(2.0)".

    Raises:
        DriverError: for a name that isn't known (lists those that are), or a model that doesn't speak the protocol.
    """
    model = _load(name)
    if protocol is None or protocol in model.protocols:
        return model
    if name + MX2_SUFFIX in _STEMS and protocol in (other := _load(name + MX2_SUFFIX)).protocols:
        return other
    spoken = " and ".join(f"{spoken:.1f}" for spoken in model.protocols)
    raise DriverError(f"{name} speaks protocol {spoken}, not {protocol:.1f}; change the protocol or the model")


def model_by_number(model_number: int) -> ServoModel | None:
    """The model that answers a ping with this number, None for one that isn't here."""
    name = _names_by_number().get(model_number)
    return None if name is None else _load(name)


@cache
def _load(name: str) -> ServoModel:
    from drivers.servo_models.files import read_model  # here, because pydantic takes a while to import

    if name not in _STEMS:
        near = [
            known for known in MODELS if name.upper().startswith(known)
        ]  # with a connector's suffix, or small letters
        guess = f"did you mean {near[-1]}? " if near else ""
        raise DriverError(f"no servo model '{name}'; {guess}have {', '.join(MODELS)}")
    return read_model(_STEMS[name])


@cache
def _names_by_number() -> dict[int, str]:
    from drivers.servo_models.files import read_number

    return {read_number(stem): name for name, stem in _STEMS.items()}
