"""The fit's numbers, each with its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from station.compare import UNIT_NAME, UNIT_SCALE
from station.logs import FloatArray, JointLog
from station.report.blocks import Block, Folded, Section, Table, Text
from station.report.material import Material
from station.report.tables import three_digits

if TYPE_CHECKING:
    from station.kinematics.tree import Joint, KinematicTree

MM_PER_M = 1e3
# Less than this is written as such.
LEAST_PROBABILITY = 1e-4
WHAT = (
    "Axis: unit vector in the parent's frame, with the root of the variance over its two degrees of freedom. Point: "
    "the one of the axis nearest to the child. State std: median and 95th percentile of the standard deviation of the "
    "joint's state over the frames. Rms: what the joint leaves unexplained, over the frames that are no outliers. The "
    "deviations are those of the detection's noise: they know nothing of a wrong calibration or marker size."
)
PROBABILITIES = (
    "Probability of each type among those that were tried; below, the scores that they come from, lower is better."
)


def fit_section(material: Material) -> Section | None:
    """None where nothing was fitted or no joint was found."""
    if material.fit is None or not material.fit.tree.joints:
        return None
    tree, states = material.fit.tree, material.fit.states
    blocks: list[Block] = [_numbers(tree, states), Text(WHAT, soft=True)]
    if any(joint.probability for joint in tree.joints):
        blocks += [_probabilities(tree), Text(PROBABILITIES, soft=True)]
    if any(joint.scores for joint in tree.joints):
        blocks.append(Folded("scores", [_scores(tree)]))
    return Section("fit", "Fit", "The fit's numbers", blocks)


def _numbers(tree: KinematicTree, states: JointLog) -> Table:
    head = ["joint", "type", "axis", "± [deg]", "point [mm]", "± [mm]", "state std", "rms [deg]", "rms [mm]"]
    head += ["frames", "outliers"]
    rows = [_row(joint, states) for joint in tree.joints]
    if any(joint.pitch_m_per_rad is not None for joint in tree.joints):
        head.append("advance [mm/turn]")
        rows = [[*row, _advance(joint)] for row, joint in zip(rows, tree.joints, strict=True)]
    return Table("numbers of the fit", head, rows, frozenset({1}))


def _row(joint: Joint, states: JointLog) -> list[str]:
    return [
        joint.name,
        joint.type,
        _vector(joint.axis_parent, "{:z.4f}"),
        _scaled(joint.axis_std_rad, UNIT_SCALE["rad"]),
        _vector(None if joint.point_parent_m is None else MM_PER_M * joint.point_parent_m, "{:z.2f}"),
        _scaled(joint.point_std_m, MM_PER_M),
        _state_std(joint, states),
        _scaled(joint.rms_rotation_rad, UNIT_SCALE["rad"]),
        _scaled(joint.rms_translation_m, MM_PER_M),
        "" if joint.frames is None else str(joint.frames),
        "" if joint.outliers is None else str(joint.outliers),
    ]


def _advance(joint: Joint) -> str:
    turn = 2 * np.pi * MM_PER_M
    std = "" if joint.pitch_std_m_per_rad is None else f" ± {_scaled(joint.pitch_std_m_per_rad, turn)}"
    return _scaled(joint.pitch_m_per_rad, turn) + std


def _vector(values: FloatArray | None, form: str) -> str:
    return "" if values is None else ", ".join(form.format(value) for value in values.tolist())


def _scaled(value: float | None, scale: float) -> str:
    if value is None:
        return ""
    scaled = scale * value
    return f"{scaled:.2g}" if 0 < abs(scaled) < 0.1 else three_digits(scaled)


def _state_std(joint: Joint, states: JointLog) -> str:
    if states.std is None or not joint.columns or not set(joint.columns) <= set(states.joints):
        return ""
    std = np.concatenate([states.std[:, states.joints.index(column)] for column in joint.columns])
    known = std[np.isfinite(std)]
    if not len(known):
        return ""
    middle, most = np.percentile(UNIT_SCALE[joint.unit] * known, [50.0, 95.0]).tolist()
    return f"{_scaled(middle, 1.0)}, {_scaled(most, 1.0)} {UNIT_NAME[joint.unit]}"


def _probabilities(tree: KinematicTree) -> Table:
    types = list(dict.fromkeys(kind for joint in tree.joints for kind in joint.probability or ()))
    rows = [[joint.name, *(_probability(joint.probability, kind) for kind in types)] for joint in tree.joints]
    return Table("probabilities of the joints' types", ("joint", *types), rows)


def _probability(of: Mapping[str, float] | None, kind: str) -> str:
    value = None if of is None else of.get(kind)
    if value is None or np.isnan(value):
        return ""
    return f"< {LEAST_PROBABILITY:g}" if value < LEAST_PROBABILITY else f"{value:.4f}"


def _scores(tree: KinematicTree) -> Table:
    scores = [joint.scores or {} for joint in tree.joints]
    types = list(dict.fromkeys(kind for each in scores for kind in each if kind != "criterion"))
    rows = [
        [joint.name, str(each.get("criterion", "")), *(_score(each.get(kind)) for kind in types)]
        for joint, each in zip(tree.joints, scores, strict=True)
    ]
    return Table("scores of the joints' types", ("joint", "criterion", *types), rows, frozenset({1}))


def _score(value: float | str | None) -> str:
    return "" if not isinstance(value, int | float) or np.isnan(value) else f"{value:.1f}"
