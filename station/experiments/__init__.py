"""Experiments: many simulated objects fitted and scored, on this machine or a cluster (the paper's Experiment 1)."""

from station.experiments.cluster import DaskCluster
from station.experiments.fits import fitted, run_cell, simulated
from station.experiments.grid import Cell, Grid, NamedTree, NoiseLevel
from station.experiments.local_processes import Processes
from station.experiments.rows import JointRow, Row
from station.experiments.store import Sweep, read_sweep
from station.experiments.sweep import run_sweep
from station.experiments.workers import Workers

__all__ = [
    "Cell",
    "DaskCluster",
    "Grid",
    "JointRow",
    "NamedTree",
    "NoiseLevel",
    "Processes",
    "Row",
    "Sweep",
    "Workers",
    "fitted",
    "read_sweep",
    "run_cell",
    "run_sweep",
    "simulated",
]
