"""Small grids for tests of sweeps: a door and a drawer, each fitted in some milliseconds."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Any

import numpy as np

from station.experiments import Cell, Grid, NamedTree, NoiseLevel, Row
from station.experiments.fits import Outcome
from station.kinematics.tree import Joint, KinematicTree
from station.simulate import SimulationOptions

LEVELS = (NoiseLevel(0.001, 0.002), NoiseLevel(0.01, 0.02))


def tree_of(type_: str) -> KinematicTree:
    """Two bodies and a joint."""
    joint = Joint(
        name="moves",
        type=type_,
        parent="wall",
        child="leaf",
        axis_parent=np.array([0.0, 0.0, 1.0]),
        point_parent_m=np.array([0.1, 0.0, 0.0]) if type_ == "revolute" else None,
        T_parent_child_zero=np.array([[1, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]),
        limits=(0.0, 0.5),
    )
    return KinematicTree("wall", ("wall", "leaf"), (), (("wall", "leaf"),), (joint,))


DOOR, DRAWER = NamedTree("door", tree_of("revolute")), NamedTree("drawer", tree_of("prismatic"))


def small_grid(**changes: Any) -> Grid:
    """Eight fits: a door, by the station's method, two noise levels, two inflations, two repeats."""
    usual = Grid(
        trees=(DOOR,),
        methods=("station",),
        noise=LEVELS,
        inflation=(0, 1),
        repeats=2,
        options=SimulationOptions(frames=20),
    )
    return replace(usual, **changes)


class Here(Executor):
    """Does what is submitted at once, in this thread."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except BaseException as error:
            future.set_exception(error)
        return future


def outcome_of(cell: Cell) -> Outcome:
    """A made-up one."""
    return Outcome(Row(cell, True, True, False, 0.5, None, (), 0.01, None, "made up"), None)


def made_up_cells(cells: Sequence[Cell], trees: object, kept: Sequence[bool]) -> list[Outcome]:
    """In place of `run_cells`: without a fit; the last of many cells are given back."""
    return [outcome_of(cell) for cell in cells[:2]]


def numbers(row: Row) -> tuple[object, ...]:
    """All of a row that must be the same whoever fits it, and when."""
    correct = (row.groups_correct, row.structure_correct, row.types_correct)
    return *row.cell.key, row.cell.seed, *correct, row.axis_error_deg, row.point_error_mm, row.joints, row.error
