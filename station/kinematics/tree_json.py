"""kinematics.json, schema kinematics/1: strict JSON to a KinematicTree and back; degrees and millimetres at this edge.

A tree drawn by hand needs `schema`, `root`, `parts` and `joints`, and of a joint `name`, `type`, `parent`, `child`,
`T_parent_child_zero` and what the type needs of `axis_parent`, `point_parent_m` and `pitch_m_per_rad`; all else may be
absent or null. `mounts` has T_body_part of further trackers by part, where they are known; older files have none.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NoReturn, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from station.errors import InvalidData, InvalidFile
from station.kinematics.tree import Joint, KinematicTree, connected_bodies
from station.logs import FloatArray

SCHEMA = "kinematics/1"
LINE_LENGTH = 110  # characters; what is shorter stands on one line
MM_PER_M = 1000.0

Vector = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
Row = Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Row], Field(min_length=4, max_length=4)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _State(_Strict):
    unit: str | None = None
    min: FiniteFloat | None = None
    max: FiniteFloat | None = None


class _Limits(_Strict):
    min: FiniteFloat
    max: FiniteFloat


class _Rms(_Strict):
    rotation_deg: FiniteFloat | None = None
    translation_mm: FiniteFloat | None = None


class _Std(_Strict):
    axis_deg: FiniteFloat | None = None
    point_mm: FiniteFloat | None = None
    pitch_mm_per_rad: FiniteFloat | None = None


class _Joint(_Strict):
    name: str
    type: str
    parent: str
    child: str
    axis_parent: Vector | None = None
    point_parent_m: Vector | None = None
    pitch_m_per_rad: FiniteFloat | None = None
    T_parent_child_zero: Matrix
    state: _State | None = None
    limits: _Limits | None = None
    scores: dict[str, FiniteFloat | str | None] | None = None
    criteria: dict[str, dict[str, FiniteFloat | None]] | None = None
    probability: dict[str, FiniteFloat | None] | None = None
    rms: _Rms | None = None
    frames: int | None = None
    outliers: int | None = None
    std: _Std | None = None


class _Tree(_Strict):
    schema_: str = Field(alias="schema")
    root: str
    parts: list[str]
    rigid_groups: list[list[str]] = []
    trees: list[list[str]] | None = None
    joints: list[_Joint]
    mounts: dict[str, Matrix] = {}
    method: dict[str, Any] = {}
    warnings: list[str] = []


def to_json(tree: KinematicTree) -> str:
    """Text of a kinematics.json; numbers that aren't finite become null.

    Raises:
        InvalidData: if `tree.method` holds what JSON can't.
    """
    values = {
        "schema": SCHEMA,
        "root": tree.root,
        "parts": tree.parts,
        "rigid_groups": tree.rigid_groups,
        "trees": tree.trees,
        "joints": [_joint_values(joint) for joint in tree.joints],
        **({"mounts": tree.mounts} if tree.mounts else {}),
        "method": tree.method,
        "warnings": tree.warnings,
    }
    return _pretty(_plain(values, "kinematics"), "") + "\n"


def from_json(text: str, name: str) -> KinematicTree:
    """Read the text of a kinematics.json.

    Args:
        text: the file's text.
        name: the file's name, for errors.

    Raises:
        InvalidFile: for what is no strict JSON, another schema, unknown and missing keys, wrong types, and for what can
            be no tree (see `KinematicTree` and `Joint`).
    """
    values = _strict_values(text, name)
    if not isinstance(values, dict):
        raise InvalidFile(f'{name} holds no JSON object; want one with "schema": "{SCHEMA}"')
    values = cast(dict[str, Any], values)
    if values.get("schema") != SCHEMA:
        have = json.dumps(values["schema"]) if "schema" in values else "missing"
        raise InvalidFile(f'{name}: schema is {have}; this version reads "{SCHEMA}"')
    try:
        return _to_tree(_Tree.model_validate(values))
    except ValidationError as error:
        raise InvalidFile(f"{name}: {_first_complaint(error)}") from None
    except InvalidData as error:
        raise InvalidFile(f"{name}: {error}") from None


def _joint_values(joint: Joint) -> dict[str, object]:
    values: dict[str, object] = {
        "name": joint.name,
        "type": joint.type,
        "parent": joint.parent,
        "child": joint.child,
        "axis_parent": joint.axis_parent,
        "point_parent_m": joint.point_parent_m,
        "pitch_m_per_rad": joint.pitch_m_per_rad,
        "T_parent_child_zero": joint.T_parent_child_zero,
        "state": {"unit": joint.unit, "min": joint.state_min, "max": joint.state_max} if joint.unit else None,
    }
    if joint.limits is not None:
        values["limits"] = {"min": joint.limits[0], "max": joint.limits[1]}
    values["scores"] = joint.scores
    if joint.criteria is not None:
        values["criteria"] = joint.criteria
    return values | {
        "probability": joint.probability,
        "rms": {"rotation_deg": _degrees(joint.rms_rotation_rad), "translation_mm": _mm(joint.rms_translation_m)},
        "frames": joint.frames,
        "outliers": joint.outliers,
        "std": {"axis_deg": _degrees(joint.axis_std_rad), "point_mm": _mm(joint.point_std_m)} | _pitch_std(joint),
    }


def _pitch_std(joint: Joint) -> dict[str, float | None]:
    """Of joints that have a pitch; the others don't mention it."""
    return {"pitch_mm_per_rad": _mm(joint.pitch_std_m_per_rad)} if joint.kind.form_freedoms else {}


def _to_joint(model: _Joint) -> Joint:
    state, rms, std = model.state or _State(), model.rms or _Rms(), model.std or _Std()
    joint = Joint(
        name=model.name,
        type=model.type,
        parent=model.parent,
        child=model.child,
        axis_parent=_array(model.axis_parent),
        point_parent_m=_array(model.point_parent_m),
        T_parent_child_zero=np.array(model.T_parent_child_zero),
        pitch_m_per_rad=model.pitch_m_per_rad,
        state_min=state.min,
        state_max=state.max,
        limits=None if model.limits is None else (model.limits.min, model.limits.max),
        scores=_scores(model),
        criteria=_criteria(model),
        probability=None if model.probability is None else {k: _number(x) for k, x in model.probability.items()},
        rms_rotation_rad=_radians(rms.rotation_deg),
        rms_translation_m=_metres(rms.translation_mm),
        frames=model.frames,
        outliers=model.outliers,
        axis_std_rad=_radians(std.axis_deg),
        point_std_m=_metres(std.point_mm),
        pitch_std_m_per_rad=_metres(std.pitch_mm_per_rad),
    )
    if state.unit is not None and state.unit != joint.unit:
        want = f"'{joint.unit}'" if joint.unit else "no state"
        raise InvalidData(f"joint '{joint.name}': state in '{state.unit}'; want {want} for a {joint.type} joint")
    return joint


def _scores(model: _Joint) -> dict[str, float | str] | None:
    if model.scores is None:
        return None
    for key, value in model.scores.items():
        if isinstance(value, str) != (key == "criterion"):
            want = "a name" if key == "criterion" else "a number or null"
            raise InvalidData(f"joint '{model.name}': scores.{key} is {json.dumps(value)}; want {want}")
    return {key: value if isinstance(value, str) else _number(value) for key, value in model.scores.items()}


def _criteria(model: _Joint) -> dict[str, dict[str, float]] | None:
    if model.criteria is None:
        return None
    return {name: {key: _number(value) for key, value in scores.items()} for name, scores in model.criteria.items()}


def _to_tree(model: _Tree) -> KinematicTree:
    joints = [_to_joint(joint) for joint in model.joints]
    trees = model.trees
    if trees is None:
        trees = connected_bodies(_named_parts(model, joints), joints)
    return KinematicTree(
        root=model.root,
        parts=tuple(model.parts),
        rigid_groups=tuple(tuple(group) for group in model.rigid_groups),
        trees=tuple(tuple(names) for names in trees),
        joints=tuple(joints),
        method=model.method,
        warnings=tuple(model.warnings),
        mounts={part: np.array(T) for part, T in model.mounts.items()},
    )


def _named_parts(model: _Tree, joints: Sequence[Joint]) -> list[str]:
    """A part for each body: of a rigid group the one at a joint or the root, else its first."""
    used = {model.root} | {name for joint in joints for name in (joint.parent, joint.child)}
    others = {
        part
        for group in model.rigid_groups
        for part in group
        if part != next((member for member in group if member in used), group[0])
    }
    return [part for part in model.parts if part not in others]


def _strict_values(text: str, name: str) -> object:
    def refuse_constant(constant: str) -> NoReturn:
        raise InvalidFile(f"{name}: {constant} is no JSON; want null")

    def refuse_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        values = dict(pairs)
        if len(values) != len(pairs):
            keys = [key for key, _ in pairs]
            raise InvalidFile(f"{name}: key '{next(k for k in keys if keys.count(k) > 1)}' is there twice")
        return values

    try:
        return json.loads(text, parse_constant=refuse_constant, object_pairs_hook=refuse_twice)
    except json.JSONDecodeError as error:
        raise InvalidFile(f"{name} is no JSON: {error}") from None
    except RecursionError:
        raise InvalidFile(f"{name} is no tree: brackets too deep") from None


def _first_complaint(error: ValidationError) -> str:
    """What is wrong where, for the first of pydantic's errors, with the keys that are known if one isn't."""
    first = error.errors()[0]
    where = ""
    for step in first["loc"]:
        where += f"[{step}]" if isinstance(step, int) else f".{step}" if where else str(step)
    if first["type"] == "extra_forbidden":
        return f"unknown key '{where}'; known there: {', '.join(_known_keys(first['loc'][:-1]))}"
    if first["type"] == "missing":
        return f"no key '{where}'"
    return f"{where}: {first['msg']}"


def _known_keys(loc: Sequence[int | str]) -> list[str]:
    models: Mapping[str, type[_Strict]] = {
        "joints": _Joint,
        "state": _State,
        "limits": _Limits,
        "rms": _Rms,
        "std": _Std,
    }
    last = next((step for step in reversed(loc) if isinstance(step, str)), None)
    model = _Tree if last is None else models[last]
    return [info.alias or key for key, info in model.model_fields.items()]


def _array(values: list[float] | None) -> FloatArray | None:
    return None if values is None else np.array(values)


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else math.degrees(angle_rad)


def _radians(angle_deg: float | None) -> float | None:
    return None if angle_deg is None else math.radians(angle_deg)


def _mm(length_m: float | None) -> float | None:
    return None if length_m is None else length_m * MM_PER_M


def _metres(length_mm: float | None) -> float | None:
    return None if length_mm is None else length_mm / MM_PER_M


def _plain(value: object, where: str) -> object:
    """The value in lists, dicts, text, numbers and None; raises InvalidData for anything else."""
    if isinstance(value, np.ndarray | np.generic):
        value = cast(object, value.tolist())
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        items = cast(Mapping[object, object], value).items()
        return {str(key): _plain(item, f"{where}.{key}") for key, item in items}
    if isinstance(value, list | tuple):
        return [_plain(item, where) for item in cast(Sequence[object], value)]
    raise InvalidData(f"{where} is a {type(value).__name__}; want what JSON can hold")


def _pretty(value: object, indent: str) -> str:
    """JSON text in which short values stand on one line."""
    line = json.dumps(value, allow_nan=False, ensure_ascii=False)
    if len(indent) + len(line) <= LINE_LENGTH or not isinstance(value, dict | list):
        return line
    inner = indent + " "
    if isinstance(value, list):
        items = [_pretty(item, inner) for item in cast(list[object], value)]
    else:
        pairs = cast(dict[str, object], value).items()
        items = [f"{json.dumps(key, ensure_ascii=False)}: {_pretty(item, inner)}" for key, item in pairs]
    brackets = "[]" if isinstance(value, list) else "{}"
    return f"{brackets[0]}\n{inner}" + f",\n{inner}".join(items) + f"\n{indent}{brackets[1]}"
