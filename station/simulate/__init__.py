"""Motion of articulated objects (`station.simulate(tree)` calls `simulate` below) and, beside it, rendered scenes."""

from __future__ import annotations

import sys

from station.callable_module import CallableModule
from station.kinematics.tree import KinematicTree
from station.simulate.camera_noise import CameraNoise
from station.simulate.motions import MOTIONS, start_root, start_states, walk_root, walk_states
from station.simulate.noise import GaussianNoise, Noise, StudentNoise, UniformNoise
from station.simulate.noise_models import NOISE_MODELS, make_noise
from station.simulate.options import ROOTS, SimulationOptions
from station.simulate.placing import place_objects
from station.simulate.simulator import Simulated, check_movable, simulate_all
from station.simulate.state_ranges import StateRanges, state_ranges

__all__ = [
    "MOTIONS",
    "NOISE_MODELS",
    "ROOTS",
    "CameraNoise",
    "GaussianNoise",
    "Noise",
    "Simulated",
    "SimulationOptions",
    "StateRanges",
    "StudentNoise",
    "UniformNoise",
    "check_movable",
    "make_noise",
    "place_objects",
    "simulate",
    "simulate_all",
    "start_root",
    "start_states",
    "state_ranges",
    "walk_root",
    "walk_states",
]


def simulate(tree: KinematicTree, options: SimulationOptions | None = None, seed: int = 0) -> Simulated:
    """Move an articulated object at random and watch it with noise: Algorithm 2 of the paper.

    Args:
        tree: any, with limits of its joints (see `state_ranges`).
        options: how; the defaults if None.
        seed: of all that is random, 0 or more. The motion doesn't depend on the noise.

    Raises:
        InvalidData: a StationError: a prismatic joint without limits, an object that is not planar though the options
            say so, a seed that is none.
    """
    return simulate_all(tree, options, (seed,))[0]


sys.modules[__name__].__class__ = CallableModule
