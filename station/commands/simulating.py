"""`station simulate` as a function: a tree moves at random, and what a tracker would report of it is written.

Takes paths and options, returns what was written, and raises StationError; printing is left to the caller.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from station.comparison_files import write_files
from station.errors import InvalidData, InvalidFile, OutputExists, StationError
from station.formats.joint_csv import format_joint_states
from station.formats.poses_csv import format_poses_csv
from station.formats.trees import load_tree
from station.kinematics.tree_json import to_json
from station.simulate import Simulated, SimulationOptions, check_movable, simulate_all

ENDING = ".csv"
# A fit wants of every part some poses.
FEW_POSES = 10


@dataclass(frozen=True)
class SimulationFiles:
    """What was simulated and where it was written.

    Attributes:
        poses: poses.csv.
        truth: poses without noise, true states, and the true tree, where they were asked for.
        warnings: plain sentences.
    """

    simulated: Simulated
    poses: Path
    truth: tuple[Path, ...]
    warnings: tuple[str, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """All that was written, the poses first."""
        return (self.poses, *self.truth)

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        log, tree = self.simulated.log, self.simulated.tree
        return {
            "files": [str(path) for path in self.files],
            "seed": self.simulated.seed,
            "reference": log.reference,
            "frames": len(log.t_s),
            "parts": list(log.parts),
            "poses": int(np.count_nonzero(log.seen)),
            "bodies": list(tree.bodies),
            "joints": [{"name": joint.name, "type": joint.type} for joint in tree.joints],
            "warnings": list(self.warnings),
        }


def simulate(
    tree: str | PathLike[str],
    out: str | PathLike[str],
    *,
    options: SimulationOptions | None = None,
    seed: int = 0,
    truth: bool = False,
    force: bool = False,
) -> SimulationFiles:
    """Move an articulated object at random and write what a tracker would report: Algorithm 2 of the paper.

    Args:
        tree: a kinematics.json, a URDF, a fit's folder, or a packaged tree's name.
        out: the poses.csv; its folder is made if it isn't there.
        options: how; the defaults if None.
        seed: of all that is random.
        truth: whether to write beside `poses.csv` also `poses_truth.csv` (without noise), `poses_states.csv` (of the
            joints) and `poses_tree.json` (virtual trackers in its rigid groups).
        force: overwrite what is there.

    Raises:
        StationError: a tree that can't be read or moved, a file that is there or can't be written.
    """
    out = Path(out)
    if out.suffix.lower() != ENDING:
        raise InvalidData(
            f"--out is '{out}'; want a file ending in {ENDING}, such as poses{ENDING}\n"
            f"for another format, afterwards: station export poses{ENDING} --out poses.parquet"
        )
    beside = [out.with_name(f"{out.stem}_{what}") for what in ("truth.csv", "states.csv", "tree.json")]
    _check_free([out, *beside] if truth else [out], force)
    loaded = load_tree(tree)
    options = options or SimulationOptions()
    try:
        check_movable(loaded, planar=options.planar)
    except InvalidData as error:
        raise InvalidFile(f"{tree}: {error}") from error
    (made,) = simulate_all(loaded, options, (seed,))
    texts = [format_poses_csv(made.log)]
    if truth:
        texts += [format_poses_csv(made.truth), format_joint_states(made.states), to_json(made.tree)]
    files = [out, *beside][: len(texts)]
    try:
        write_files(out.parent, {path.name: text.encode() for path, text in zip(files, texts, strict=True)})
    except OSError as error:
        raise StationError(f"can't write '{out}': {error.strerror}; name another file with --out") from error
    return SimulationFiles(made, out, tuple(files[1:]), _warnings(made))


def _check_free(files: list[Path], force: bool) -> None:
    for path in files:
        if path.is_dir():
            raise OutputExists(f"{path} is a folder; name a file in it: --out {path / 'poses.csv'}")
        if path.exists() and not force:
            raise OutputExists(f"{path} exists\nname another file with --out, or overwrite with --force")


def _warnings(made: Simulated) -> tuple[str, ...]:
    log = made.log
    seen = log.seen.sum(axis=0)
    few = [f"{part} ({count})" for part, count in zip(log.parts, seen.tolist(), strict=True) if count < FEW_POSES]
    return (f"fewer than {FEW_POSES} poses to fit of {', '.join(few)}",) if few else ()
