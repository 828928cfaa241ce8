"""The grid of a sweep: trees x methods x noise levels x inflation x repeats; one cell of it is one fit."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise, product

from station.errors import InvalidData
from station.fit.options import METHODS
from station.kinematics.tree import Joint, KinematicTree
from station.logs import check_slugs
from station.simulate import Noise, SimulationOptions, make_noise, simulate

# Far more than anyone waits for; a slip of the keyboard.
MOST_FITS = 1_000_000
# A seed is a whole number that float64 holds, too: tables are read by programs that know no other numbers.
SEED_BITS = 53
# What the levels and repeats of a grid vary.
VARIED = ("noise", "inflation")
MAGNITUDES = ("translation_m", "rotation_rad")


@dataclass(frozen=True)
class NoiseLevel:
    """Magnitudes (eps_T, eps_R) of the noise; what they are of, its model says."""

    translation_m: float
    rotation_rad: float

    def __post_init__(self) -> None:
        for name in ("translation_m", "rotation_rad"):
            object.__setattr__(self, name, float(getattr(self, name)) + 0.0)  # -0.0 and 0 are 0.0, for their seeds


@dataclass(frozen=True)
class NamedTree:
    """A tree that generates motions, under the name that rows tell it by."""

    name: str
    tree: KinematicTree


# From where the paper's method has all of experiment1 right to where it makes a revolute joint of the prismatic one.
NOISE_LEVELS = (NoiseLevel(0.0005, 0.02), NoiseLevel(0.0025, 0.1), NoiseLevel(0.005, 0.2), NoiseLevel(0.01, 0.4))
# In fewer, a random walk often leaves a joint where it is.
FRAMES = 200


@dataclass(frozen=True, eq=False)
class Cell:
    """One fit of a grid.

    Attributes:
        tree: name of the generating tree.
        method: of the fit.
        options: of the simulation.
        repeat: counted from 0.
        seed: of the simulation. It follows from the grid's seed and from what is simulated, and not from the method:
            all methods see the same log, whatever else is in the grid.
    """

    tree: str
    method: str
    options: SimulationOptions
    repeat: int
    seed: int

    @property
    def noise(self) -> NoiseLevel:
        """Magnitudes of the noise."""
        return NoiseLevel(self.options.noise.translation_m, self.options.noise.rotation_rad)

    @property
    def key(self) -> CellKey:
        """What tells it from the other cells of its grid."""
        noise = self.options.noise
        return self.tree, self.method, noise.translation_m, noise.rotation_rad, self.options.inflation, self.repeat


CellKey = tuple[str, str, float, float, int, int]


@dataclass(frozen=True, eq=False)
class Grid:
    """What a sweep fits, checked.

    Attributes:
        trees: one or more, with distinct names.
        methods: of the fit.
        noise: levels, each louder than the last.
        inflation: numbers of virtual trackers near each part, rising.
        repeats: fits of each method, tree, noise level and inflation, each with its own motion and noise.
        seed: of the whole grid.
        noise_model: key of `NOISE_MODELS`.
        noise_parameters: what else it can be told, by name, such as the freedom of "student"; None leaves the default.
        options: of all simulations; their noise and inflation are those of the levels.

    Raises:
        InvalidData: for axes that are empty, that repeat or fall, and for values that can't be, with those that can.
    """

    trees: tuple[NamedTree, ...]
    methods: tuple[str, ...] = ("paper", "station")
    noise: tuple[NoiseLevel, ...] = NOISE_LEVELS
    inflation: tuple[int, ...] = (0, 1, 2, 3)
    repeats: int = 4
    seed: int = 0
    noise_model: str = "uniform"
    noise_parameters: Mapping[str, float | None] = field(default_factory=dict[str, float | None])
    options: SimulationOptions = field(default_factory=lambda: SimulationOptions(frames=FRAMES))

    def __post_init__(self) -> None:
        for name in ("trees", "methods", "noise", "inflation"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
            if not getattr(self, name):
                raise InvalidData(f"the grid has no {name}; want one or more")
        check_slugs([named.name for named in self.trees], "tree")
        _check_known(self.methods, METHODS, "method")
        parameters = {name: value for name, value in self.noise_parameters.items() if value is not None}
        object.__setattr__(self, "noise_parameters", parameters)
        _check_levels(self.noise)
        _check_inflation(self.inflation)
        _check_whole(self.repeats, "repeats", 1)
        _check_whole(self.seed, "seed", 0)
        if len(self) > MOST_FITS:
            raise InvalidData(f"the grid has {len(self):,} fits; want {MOST_FITS:,} at most: fewer levels or repeats")
        self._check_simulations()

    def __len__(self) -> int:
        return len(self.trees) * len(self.methods) * len(self.noise) * len(self.inflation) * self.repeats

    def simulations(self) -> list[SimulationOptions]:
        """Options of all noise levels and inflations; raises InvalidData if the simulator refuses some."""
        return [
            replace(self.options, noise=self.noise_of(level), inflation=inflation)
            for level, inflation in product(self.noise, self.inflation)
        ]

    def _check_simulations(self) -> None:
        """Raise InvalidData if the simulator refuses a simulation, or a tree, such as one that isn't planar."""
        short = [replace(options, frames=1, inflation=0) for options in self.simulations()]
        for named in self.trees:
            try:
                simulate(named.tree, short[0], 0)
            except InvalidData as error:
                raise InvalidData(f"tree '{named.name}': {error}") from None

    def noise_of(self, level: NoiseLevel) -> Noise:
        """The noise of a level."""
        return make_noise(self.noise_model, level.translation_m, level.rotation_rad, self.noise_parameters)

    def cells(self) -> tuple[Cell, ...]:
        """All cells, repeat after repeat, so that a sweep that was broken off tells something of all levels."""
        simulations, prints = self.simulations(), {named.name: fingerprint(named.tree) for named in self.trees}
        return tuple(
            Cell(named.name, method, options, repeat, cell_seed(self.seed, prints[named.name], options, repeat))
            for repeat in range(self.repeats)
            for named, options, method in product(self.trees, simulations, self.methods)
        )

    def tree(self, name: str) -> KinematicTree:
        """The generating tree of that name; raises InvalidData if there is none."""
        for named in self.trees:
            if named.name == name:
                return named.tree
        raise InvalidData(f"no tree '{name}' in the grid; have {', '.join(named.name for named in self.trees)}")


def told_options(options: SimulationOptions) -> dict[str, object]:
    """What of a simulation's options differs from what is usual, as JSON values; noise as its model and magnitudes."""
    usual = SimulationOptions()
    noise = options.noise
    told: dict[str, object] = {"noise": [noise.name, noise.translation_m, noise.rotation_rad]}
    more = {entry.name: getattr(noise, entry.name) for entry in fields(noise) if entry.name not in MAGNITUDES}
    told |= {f"noise.{name}": value for name, value in more.items() if value != getattr(type(noise)(), name)}
    names = [entry.name for entry in fields(SimulationOptions) if entry.name != "noise"]
    return told | {name: getattr(options, name) for name in names if getattr(options, name) != getattr(usual, name)}


def cell_seed(seed: int, tree: str, options: SimulationOptions, repeat: int) -> int:
    """The seed of a simulation: of the grid's seed, the tree's `fingerprint`, its options and the repeat alone."""
    told = json.dumps([seed, tree, told_options(options), repeat], sort_keys=True)
    return int.from_bytes(hashlib.sha256(told.encode()).digest()) >> (256 - SEED_BITS)


def fingerprint(tree: KinematicTree) -> str:
    """Of what a simulation takes from a tree; what a fit may have said about it doesn't count, nor does its name."""
    told = [tree.root, tree.parts, tree.rigid_groups, tree.trees, [_told_joint(joint) for joint in tree.joints]]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def _told_joint(joint: Joint) -> list[object]:
    where = [None if value is None else value.tolist() for value in (joint.axis_parent, joint.point_parent_m)]
    range_ = [joint.limits, joint.state_min, joint.state_max]
    zero = joint.T_parent_child_zero.tolist()
    return [joint.name, joint.type, joint.parent, joint.child, *where, zero, joint.pitch_m_per_rad, *range_]


def _check_known(names: Sequence[str], choices: Sequence[str], what: str) -> None:
    for name in names:
        if name not in choices:
            raise InvalidData(f"{what} '{name}' is unknown; choose one of {', '.join(choices)}")
    twice = [name for name in names if list(names).count(name) > 1]
    if twice:
        raise InvalidData(f"{what} '{twice[0]}' is in the grid twice; want each once")


def _check_levels(levels: Sequence[NoiseLevel]) -> None:
    for level in levels:
        for value, what in ((level.translation_m, "translation [m]"), (level.rotation_rad, "rotation [rad]")):
            if not (math.isfinite(value) and value >= 0):
                raise InvalidData(f"noise of {what} is {value:g}; want a finite number, 0 or more")
    for before, after in pairwise(levels):
        rises = after.translation_m >= before.translation_m and after.rotation_rad >= before.rotation_rad
        if not rises or after == before:
            have = f"({after.translation_m:g} m, {after.rotation_rad:g} rad) after "
            have += f"({before.translation_m:g} m, {before.rotation_rad:g} rad)"
            raise InvalidData(f"noise levels: have {have}; want each louder than the last")


def _check_inflation(values: Sequence[int]) -> None:
    for value in values:
        _check_whole(value, "inflation", 0)
    for before, after in pairwise(values):
        if after <= before:
            raise InvalidData(f"inflation: have {after} after {before}; want rising numbers, each once")


def _check_whole(value: int, what: str, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise InvalidData(f"{what} is {value!r}; want a whole number, {least} or more")
