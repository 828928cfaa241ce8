"""The motion simulator of articulated objects (paper, IV-A, Algorithm 2), for many times and repeats at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from station.errors import InvalidData
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray, JointLog, PoseLog
from station.simulate.degrading import degraded, degrading_draws
from station.simulate.motions import MOTIONS, started_root
from station.simulate.noise import PLANAR, check_count
from station.simulate.options import SimulationOptions
from station.simulate.placing import Layout, check_planar, layout, place_objects
from station.simulate.state_ranges import state_ranges

# Of all repeats together, more than 1 GB while they are made.
MOST_POSES = 1_000_000
# Each purpose has random numbers of its own: a seed's motion is the same whatever the noise.
STREAMS = ("mounts", "roots", "states", "noise", "degrading")


@dataclass(frozen=True, eq=False, slots=True)
class Simulated:
    """A moving object as a tracker sees it, and as it is.

    Attributes:
        log: what a tracker would report; its covariance is None unless the options' `known_noise` asks for it.
        truth: the same without noise, wrong poses and gaps.
        states: true states of the tree's joints.
        tree: the true tree: rigid joints folded into rigid groups, as a fit tells them, virtual trackers among these.
        seed: that it is made of.
    """

    log: PoseLog
    truth: PoseLog
    states: JointLog
    tree: KinematicTree
    seed: int


def simulate_all(
    tree: KinematicTree, options: SimulationOptions | None = None, seeds: Sequence[int] = (0,)
) -> tuple[Simulated, ...]:
    """Repeats of a simulation, all at once; each to the bit as `simulate` with its seed.

    Raises:
        InvalidData: as `simulate`.
    """
    options = SimulationOptions() if options is None else options
    _check_kinds(tree, options)
    check_movable(tree, planar=options.planar)
    if not len(seeds):
        return ()
    _check_size(len(seeds) * options.frames * len(tree.parts) * (1 + options.inflation))
    what = layout(tree, options.inflation)
    draws = [_draws(options, what, len(tree.columns), seed) for seed in seeds]
    roots, paths, states, mounts, noise, wrong = (np.stack(each) for each in zip(*draws, strict=True))
    q = MOTIONS[options.motion].states(state_ranges(tree), states, options.frames)
    T_world_root = _roots(options, what, roots, paths)
    T_body_part = what.mounted(mounts, options.nearby_m, planar=options.planar)
    placed = place_objects(what.tree, T_world_root, q)
    bodies = np.stack([placed[body] for body in what.tree.bodies], axis=2)
    true = options.noise.viewed(bodies[:, :, what.body] @ T_body_part[:, None])
    seen = degraded(options.noise.apply(true, noise, planar=options.planar_noise), wrong, options)
    t_s = np.arange(options.frames) / options.rate_hz
    return tuple(_simulated(options, what.tree, t_s, true[i], seen[i], q[i], seed) for i, seed in enumerate(seeds))


def _check_kinds(tree: object, options: object) -> None:
    """Raise InvalidData for what would end confusingly: a name for a tree, a dict for options."""
    if not isinstance(tree, KinematicTree):
        raise InvalidData(
            f"simulate wants a KinematicTree; have a {type(tree).__name__}\n"
            "read one from a file, or a packaged one by its name, with station.load_tree"
        )
    if not isinstance(options, SimulationOptions):
        raise InvalidData(f"options: have a {type(options).__name__}; want SimulationOptions(frames=100)")


def check_movable(tree: KinematicTree, *, planar: bool = False) -> None:
    """Raise InvalidData for a tree that can't be moved, or not in a plane: see `state_ranges`, `check_planar`."""
    state_ranges(tree)
    if planar:
        check_planar(tree)


def _check_size(poses: int) -> None:
    if poses > MOST_POSES:
        raise InvalidData(
            f"{poses} poses at once; want {MOST_POSES} at most\nask for fewer frames, trackers, or repeats at a time"
        )


def _simulated(
    options: SimulationOptions,
    tree: KinematicTree,
    t_s: FloatArray,
    true: FloatArray,
    seen: FloatArray,
    q: FloatArray,
    seed: int,
) -> Simulated:
    reference = options.noise.reference
    covariance = options.noise.covariance(true) if options.known_noise else None
    return Simulated(
        log=PoseLog(t_s, reference, tree.parts, seen, covariance),
        truth=PoseLog(t_s, reference, tree.parts, true),
        states=JointLog(t_s, tree.columns, q, tuple(tree.units[column] for column in tree.columns)),
        tree=tree,
        seed=int(seed),
    )


def _draws(options: SimulationOptions, what: Layout, columns: int, seed: int) -> tuple[FloatArray, ...]:
    """All random numbers of one repeat, in the order that `simulate_all` stacks them."""
    check_count(seed, "seed", 0)
    streams = dict(zip(STREAMS, np.random.SeedSequence(int(seed)).spawn(len(STREAMS)), strict=True))
    rng = {name: np.random.default_rng(stream) for name, stream in streams.items()}
    motion, roots = MOTIONS[options.motion], len(what.tree.tree_roots)
    shape = (options.frames, len(what.tree.parts))
    return (
        rng["roots"].uniform(-1.0, 1.0, (roots, 6)),
        np.stack([motion.draws(rng["roots"], options.frames, 6) for _ in range(roots)]),
        motion.draws(rng["states"], options.frames, columns),
        rng["mounts"].uniform(-1.0, 1.0, (len(what.loose), 6)),
        options.noise.draws(rng["noise"], shape),
        degrading_draws(rng["degrading"], shape),
    )


def _roots(options: SimulationOptions, what: Layout, starts: FloatArray, paths: FloatArray) -> dict[str, FloatArray]:
    """(R, T, 4, 4) `T_world_root` by root, for draws (R, roots, 6) of starts and (R, roots, ...) of motions."""
    step = np.repeat([options.root_step_m, options.root_step_rad], 3) * (PLANAR if options.planar else 1.0)
    moving = options.root == "moving"
    T_world_start = started_root(starts, planar=options.planar)
    found: dict[str, FloatArray] = {}
    for i, root in enumerate(what.tree.tree_roots):
        path = MOTIONS[options.motion].path(paths[:, i], step if moving else 0 * step, options.frames)
        found[root] = T_world_start[:, None, i] @ path
    return found
