"""sweep.json, schema sweep/1: the grid of a sweep as strict JSON and back; whether one grid goes on with another."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from dataclasses import fields
from typing import Any

from station.errors import InvalidData, InvalidFile
from station.experiments.grid import VARIED, Grid, NamedTree, NoiseLevel, fingerprint
from station.kinematics.tree import KinematicTree
from station.simulate import SimulationOptions

SCHEMA = "sweep/1"


def grid_json(grid: Grid) -> str:
    """Text of a sweep.json; the trees by name, which are files of their own."""
    told = {
        "schema": SCHEMA,
        "trees": [named.name for named in grid.trees],
        "methods": grid.methods,
        "noise_model": grid.noise_model,
        "noise_parameters": grid.noise_parameters,
        "noise": [{"translation_m": level.translation_m, "rotation_rad": level.rotation_rad} for level in grid.noise],
        "inflation": grid.inflation,
        "repeats": grid.repeats,
        "seed": grid.seed,
        "simulation": _simulation(grid.options),
    }
    return json.dumps(told, indent=1, allow_nan=False) + "\n"


def parse_grid(text: str, name: str, tree: Callable[[str], KinematicTree]) -> Grid:
    """Read the text of a sweep.json.

    Args:
        text: the file's text.
        name: the file's name, for errors.
        tree: reads the tree of a name.

    Raises:
        InvalidFile: for what is no JSON, another schema, missing and unknown keys, and what can be no grid.
    """
    try:
        told: dict[str, Any] = json.loads(text)
        if told.get("schema") != SCHEMA:
            raise InvalidFile(f'{name}: schema is {told.get("schema")!r}; this version reads "{SCHEMA}"')
        return Grid(
            trees=tuple(NamedTree(each, tree(each)) for each in told["trees"]),
            methods=tuple(told["methods"]),
            noise=tuple(NoiseLevel(**level) for level in told["noise"]),
            inflation=tuple(told["inflation"]),
            repeats=told["repeats"],
            seed=told["seed"],
            noise_model=told["noise_model"],
            noise_parameters=told["noise_parameters"],
            options=SimulationOptions(**told["simulation"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError, InvalidData) as error:
        raise InvalidFile(f"{name} is no grid of a sweep: {error}") from None


def grid_changes(before: Grid, after: Grid) -> str | None:
    """Why a sweep of one grid can't go on with another, in words; None if that one has all its cells and numbers."""
    prints = {named.name: fingerprint(named.tree) for named in after.trees}
    for named in before.trees:
        if prints.get(named.name, "") != fingerprint(named.tree):
            return f"its tree '{named.name}' is " + ("another one" if named.name in prints else "not in the new grid")
    for name in ("methods", "noise", "inflation"):
        lost = _lost(getattr(before, name), getattr(after, name))
        if lost:
            return f"its {name} {', '.join(map(_level_text, lost))} is not in the new grid"
    for name in ("seed", "noise_model", "noise_parameters"):
        if getattr(before, name) != getattr(after, name):
            return f"its {name} is {getattr(before, name)}, the new one's {getattr(after, name)}"
    was, wanted = _simulation(before.options), _simulation(after.options)
    for name, value in was.items():
        if value != wanted[name]:
            return f"its {name} is {value}, the new one's {wanted[name]}"
    if after.repeats < before.repeats:
        return f"it has {before.repeats} repeats, the new one {after.repeats}"
    return None


def _simulation(options: SimulationOptions) -> dict[str, object]:
    names = [entry.name for entry in fields(SimulationOptions) if entry.name not in VARIED]
    return {name: getattr(options, name) for name in names}


def _lost(before: Collection[object], after: Collection[object]) -> list[object]:
    return [value for value in before if value not in after]


def _level_text(level: object) -> str:
    return f"{level.translation_m:g} m {level.rotation_rad:g} rad" if isinstance(level, NoiseLevel) else str(level)
