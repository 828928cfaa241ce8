"""Grids of sweeps: what can be none is refused, and a cell's numbers are its own."""

import math
import pickle
import re
from dataclasses import replace
from typing import Any

import pytest

from station.errors import InvalidData
from station.experiments import Grid, NamedTree, NoiseLevel
from station.experiments.grid import fingerprint
from station.experiments.grid_json import grid_changes, grid_json, parse_grid
from station.kinematics.tree import KinematicTree
from station.simulate import SimulationOptions
from tests.experiments.made_sweeps import DOOR, DRAWER, LEVELS, small_grid, tree_of

QUIET, LOUD = LEVELS


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"trees": ()}, "the grid has no trees"),
        ({"methods": ()}, "the grid has no methods"),
        ({"noise": ()}, "the grid has no noise"),
        ({"inflation": ()}, "the grid has no inflation"),
        ({"trees": (DOOR, DOOR)}, "tree named twice: door"),
        ({"trees": (NamedTree("Door", DOOR.tree),)}, "tree 'Door' is no name"),
        ({"methods": ("papre",)}, "method 'papre' is unknown; choose one of station, paper"),
        ({"methods": ("paper", "paper")}, "method 'paper' is in the grid twice"),
        ({"noise_model": "loud"}, "noise 'loud' is unknown; choose one of uniform, gaussian"),
        ({"noise_model": "gaussian", "noise_parameters": {"freedom": 4}}, "gaussian noise has no freedom"),
        ({"noise_model": "student", "noise_parameters": {"freedom": 0}}, "degrees of freedom"),
        ({"noise": (NoiseLevel(math.nan, 0.1),)}, "noise of translation [m] is nan"),
        ({"noise": (NoiseLevel(0.1, math.inf),)}, "noise of rotation [rad] is inf"),
        ({"noise": (NoiseLevel(-0.1, 0.1),)}, "noise of translation [m] is -0.1; want a finite number, 0 or more"),
        ({"noise": (LOUD, QUIET)}, "noise levels: have (0.001 m, 0.002 rad) after (0.01 m, 0.02 rad)"),
        ({"noise": (QUIET, QUIET)}, "want each louder than the last"),
        ({"inflation": (1, 0)}, "inflation: have 0 after 1; want rising numbers"),
        ({"inflation": (1, 1)}, "inflation: have 1 after 1"),
        ({"inflation": (-1,)}, "inflation is -1; want a whole number, 0 or more"),
        ({"inflation": (0.5,)}, "inflation is 0.5"),
        ({"repeats": 0}, "repeats is 0; want a whole number, 1 or more"),
        ({"repeats": True}, "repeats is True"),
        ({"seed": -1}, "seed is -1"),
        ({"repeats": 10**9}, "fewer levels or repeats"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_a_grid_that_can_be_none_is_refused_with_what_can(changes: dict[str, Any], said: str):
    with pytest.raises(InvalidData, match=re.escape(said)):
        small_grid(**changes)


def test_a_tree_that_the_simulator_refuses_is_refused_before_anything_is_fitted():
    joint = replace(DRAWER.tree.joints[0], limits=None)
    endless = NamedTree("endless", replace(DRAWER.tree, joints=(joint,)))
    with pytest.raises(InvalidData, match=r"tree 'endless': .*limits"):
        small_grid(trees=(DOOR, endless))


def test_experiment_1_is_four_noise_levels_by_four_inflations_by_four_repeats_by_both_methods():
    grid = Grid((DOOR,))
    assert (len(grid.noise), len(grid.inflation), grid.repeats) == (4, 4, 4) and set(grid.methods) == {
        "paper",
        "station",
    }
    assert grid.inflation[0] == 0
    assert len(grid) == len(grid.cells()) == len({cell.key for cell in grid.cells()}) == 128


def seeds(grid: Grid) -> dict[object, int]:
    return {cell.key: cell.seed for cell in grid.cells()}


def test_a_cell_has_the_same_seed_in_any_grid_that_holds_it():
    alone = small_grid(noise=(LOUD,), inflation=(1,), methods=("paper",), repeats=1)
    among = small_grid(trees=(DRAWER, DOOR), methods=("paper", "station"), repeats=3)
    assert seeds(alone).items() <= seeds(among).items()


def test_methods_share_their_simulation_and_nothing_else_does():
    grid = small_grid(trees=(DOOR, DRAWER), methods=("paper", "station"))
    by_method = {method: [cell.seed for cell in grid.cells() if cell.method == method] for method in grid.methods}
    assert by_method["paper"] == by_method["station"]
    assert len(set(by_method["paper"])) == len(grid) // 2


@pytest.mark.parametrize(
    "changes",
    [
        {"seed": 1},
        {"noise_model": "gaussian"},
        {"noise_model": "student", "noise_parameters": {"freedom": 5}},
        {"options": SimulationOptions(frames=21)},
        {"options": SimulationOptions(frames=20, root="static")},
    ],
    ids=str,
)
def test_what_is_simulated_otherwise_has_other_seeds(changes: dict[str, Any]):
    for usual in (small_grid(), small_grid(noise_model="student")):
        assert not set(seeds(usual).values()) & set(seeds(small_grid(**changes)).values())


def test_a_seed_is_the_same_on_every_machine_and_a_float_holds_it():
    """The number is what it was when it was first made: tables of then can be made again."""
    first = small_grid().cells()[0].seed
    assert first == 4920490255873666
    assert all(float(seed) == seed for seed in seeds(Grid((DOOR,))).values())


def test_a_fingerprint_tells_trees_apart_by_what_moves_not_by_what_a_fit_said():
    tree = tree_of("revolute")
    said = replace(tree, joints=(replace(tree.joints[0], probability={"revolute": 1.0}, frames=10),), warnings=("so",))
    longer = replace(tree, joints=(replace(tree.joints[0], limits=(0.0, 0.6)),))
    assert fingerprint(tree) == fingerprint(said) != fingerprint(longer)


def test_a_grid_is_read_as_it_was_written():
    grid = small_grid(trees=(DOOR, DRAWER), noise_model="student", noise_parameters={"freedom": 5})
    grid = replace(grid, options=SimulationOptions(frames=20, outliers=0.1))
    trees: dict[str, KinematicTree] = {named.name: named.tree for named in grid.trees}
    again = parse_grid(grid_json(grid), "sweep.json", trees.__getitem__)
    assert seeds(again) == seeds(grid) and again.options == grid.options and again.noise_model == "student"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, None),
        ({"repeats": 3}, None),
        ({"noise": (*LEVELS, NoiseLevel(0.1, 0.2)), "inflation": (0, 1, 2), "trees": (DRAWER, DOOR)}, None),
        ({"methods": ("paper", "station")}, None),
        ({"repeats": 1}, "it has 2 repeats, the new one 1"),
        ({"seed": 5}, "its seed is 0, the new one's 5"),
        ({"noise": (LOUD,)}, "its noise 0.001 m 0.002 rad is not in the new grid"),
        ({"inflation": (1, 2)}, "its inflation 0 is not in the new grid"),
        ({"methods": ("paper",)}, "its methods station is not in the new grid"),
        ({"trees": (DRAWER,)}, "its tree 'door' is not in the new grid"),
        ({"trees": (NamedTree("door", DRAWER.tree),)}, "its tree 'door' is another one"),
        ({"options": SimulationOptions(frames=30)}, "its frames is 20, the new one's 30"),
        ({"noise_model": "gaussian"}, "its noise_model is uniform, the new one's gaussian"),
        ({"noise_parameters": {"freedom": None}}, None),
    ],
    ids=str,
)
def test_a_grid_goes_on_with_another_if_it_has_all_of_its_cells(changes: dict[str, Any], said: str | None):
    before, after = small_grid(), small_grid(**changes)
    assert grid_changes(before, after) == said
    held = seeds(before).items() <= seeds(after).items()
    assert held == (said is None)


def test_cells_and_trees_can_be_sent_to_other_processes():
    cells, tree = pickle.loads(pickle.dumps((small_grid().cells(), DOOR.tree)))
    assert [cell.key for cell in cells] == [cell.key for cell in small_grid().cells()]
    assert fingerprint(tree) == fingerprint(DOOR.tree)
