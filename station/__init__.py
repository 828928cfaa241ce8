"""Capture-and-fit station: watch a marked mechanism move, discover its joints, compare them with the commands.

    import station
    fit = station.fit(station.read_pose_log("poses.csv"))

The names below are imported when they are first used: `import station` takes no time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from station.commands.exports import export
    from station.commands.sweeping import sweep
    from station.commands.videos import track
    from station.compare import Comparison, compare
    from station.errors import StationError
    from station.fit import fit
    from station.fit.result import Fit
    from station.fit_files import read_fit, read_tree, write_fit
    from station.formats.camera_files import read_camera
    from station.formats.read import read_commands, read_pose_log
    from station.formats.trees import load_tree
    from station.kinematics.tree import Joint, KinematicTree
    from station.logs import JointLog, PoseLog
    from station.simulate import Simulated, SimulationOptions, simulate

__all__ = [
    "Comparison",
    "Fit",
    "Joint",
    "JointLog",
    "KinematicTree",
    "PoseLog",
    "Simulated",
    "SimulationOptions",
    "StationError",
    "compare",
    "export",
    "fit",
    "load_tree",
    "read_camera",
    "read_commands",
    "read_fit",
    "read_pose_log",
    "read_tree",
    "simulate",
    "sweep",
    "track",
    "write_fit",
]

# Where each name comes from. Those of `_MODULES` are modules that can be called: see station/callable_module.py.
_HOME = {
    "Comparison": "station.compare",
    "Fit": "station.fit.result",
    "Joint": "station.kinematics.tree",
    "JointLog": "station.logs",
    "KinematicTree": "station.kinematics.tree",
    "PoseLog": "station.logs",
    "Simulated": "station.simulate",
    "SimulationOptions": "station.simulate",
    "StationError": "station.errors",
    "export": "station.commands.exports",
    "load_tree": "station.formats.trees",
    "read_camera": "station.formats.camera_files",
    "read_commands": "station.formats.read",
    "read_fit": "station.fit_files",
    "read_pose_log": "station.formats.read",
    "read_tree": "station.fit_files",
    "sweep": "station.commands.sweeping",
    "track": "station.commands.videos",
    "write_fit": "station.fit_files",
}
_MODULES = ("fit", "compare", "simulate")


if not TYPE_CHECKING:  # a type checker that saw it would take any name for one that is there

    def __getattr__(name: str) -> object:
        if name in _MODULES:
            return import_module(f"station.{name}")
        if name not in _HOME:
            raise AttributeError(f"module 'station' has no attribute '{name}'")
        value = globals()[name] = getattr(import_module(_HOME[name]), name)
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
