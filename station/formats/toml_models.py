"""Strict TOML: text to a checked pydantic model, with errors that name the file, the key, what it has and wants."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from station.errors import InvalidFile

# Errors are printed on at most five lines: a headline and this many keys.
SHOWN_ERRORS = 3


class StrictModel(BaseModel):
    """A table that refuses unknown keys and does not turn one type into another."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=StrictModel)


def parse(model: type[Model], text: str, name: str, schema: str) -> Model:
    """Read TOML `text` of the file `name` into `model`.

    Args:
        schema: the value of the key `schema` that is read, such as "rig/1"; it isn't passed on to the model.

    Raises:
        InvalidFile: no TOML, another schema, unknown keys, wrong types or values; names the file and the keys.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InvalidFile(f"{name} is no TOML: {error}") from error
    check_schema(table.pop("schema", None), name, schema)
    try:
        return model.model_validate(table)
    except ValidationError as error:
        raise InvalidFile(_explain(error, name, model)) from error


def check_schema(have: Any, name: str, want: str) -> None:
    """Raise InvalidFile unless the file's schema is the one that is read."""
    if have != want:
        said = f"has schema '{have}'" if have is not None else "has no schema"
        raise InvalidFile(f"{name} {said}; this station reads '{want}'\nwrite schema = \"{want}\" as its first line")


def _explain(error: ValidationError, name: str, model: type[BaseModel]) -> str:
    lines = [_line(item, model) for item in error.errors()]
    more = f" (and {len(lines) - SHOWN_ERRORS} more)" if len(lines) > SHOWN_ERRORS else ""
    entries = "entry" if len(lines) == 1 else "entries"
    return "\n".join([f"{name}: {len(lines)} wrong {entries}{more}", *lines[:SHOWN_ERRORS]])


def _line(item: Any, model: type[BaseModel]) -> str:
    where = _path(item["loc"])
    if item["type"] == "extra_forbidden":
        return f"  {where}: unknown key; known here: {', '.join(_known_keys(model, item['loc'][:-1]))}"
    if item["type"] == "missing":
        return f"  {where}: missing"
    if item["type"] == "value_error":
        return f"  {where}: {item['ctx']['error']}" if where else f"  {item['ctx']['error']}"
    return f"  {where}: {item['msg'][0].lower()}{item['msg'][1:]}; have {item['input']!r:.60}"


def _path(loc: Sequence[int | str]) -> str:
    """Keys as a person counts them: joint 2, servo 1, zero."""
    words: list[str] = []
    for key in loc:
        if isinstance(key, int) and words:
            words[-1] += f" {key + 1}"
        else:
            words.append(str(key))
    return ", ".join(words)


def _known_keys(model: type[BaseModel], loc: Sequence[int | str]) -> list[str]:
    """Keys of the table at `loc`, found by walking the model's annotations."""
    current: type[BaseModel] = model
    for key in loc:
        if isinstance(key, str) and key in _by_alias(current):
            inner = _inner_model(_by_alias(current)[key])
            current = inner or current
    return list(_by_alias(current))


def _by_alias(model: type[BaseModel]) -> dict[str, Any]:
    return {field.alias or name: field.annotation for name, field in model.model_fields.items()}


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        if (inner := _inner_model(argument)) is not None:
            return inner
    return None
