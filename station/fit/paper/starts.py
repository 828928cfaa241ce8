"""Where the optimiser starts for each joint type: three random time points (paper, Algorithm 1, lines 3 and 5-17).

Lines 15 and 16 give the circumcentre of three positions and the plane's directions to c, and the rest to r. But in the
order of (22), fk = r R_z(q) c, it is r that tells its place in the frame in which the positions are, the parent's. So
the circumcentre belongs to r, and c = r^-1 Delta_i. (As printed the start passes through the pose i and no other.) The
directions are the columns of r's rotation; line 15 stacks them as rows, which makes its inverse.

The start remains the paper's in that it asks the positions alone: for a child on the axis, whose circle has no radius,
its axis is the noise's. The optimiser mostly finds back from there, at the cost of more steps.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from station.fit.paper.joints import PaperJoint, PaperPrismatic, PaperRevolute, PaperRigid
from station.kinematics import se3
from station.kinematics.joints.base import Z, weighted_scatter
from station.logs import FloatArray

# Measured poses T_parent_child (T, 4, 4), T >= 3, and a source of chance, to a joint to start from.
Start = Callable[[FloatArray, np.random.Generator], PaperJoint]

# Least height of the triangle of three positions, as a share of its longest side: below, they are a line and have no
# circumcentre; their middle takes its place.
FLATTEST_TRIANGLE = 1e-9


def three_times(frames: int, rng: np.random.Generator) -> tuple[int, int, int]:
    """Three different rows i, j, k."""
    i, j, k = (int(row) for row in rng.choice(frames, size=3, replace=False))
    return i, j, k


def start_rigid(T_parent_child: FloatArray, rng: np.random.Generator) -> PaperRigid:
    """One of the poses (line 6)."""
    i, _, _ = three_times(len(T_parent_child), rng)
    return PaperRigid(T_parent_child[i])


def start_prismatic(T_parent_child: FloatArray, rng: np.random.Generator) -> PaperPrismatic:
    """One of the poses, and the direction from it to another (line 9); z if they are at the same place."""
    i, _, k = three_times(len(T_parent_child), rng)
    way = T_parent_child[k, :3, 3] - T_parent_child[i, :3, 3]
    length = np.linalg.norm(way)
    return PaperPrismatic(T_parent_child[i], way / length if length > 0 else Z)


def start_revolute(T_parent_child: FloatArray, rng: np.random.Generator) -> PaperRevolute:
    """The circumcentre of three positions in the plane of all (lines 12-16, with r and c in their right places)."""
    i, j, k = three_times(len(T_parent_child), rng)
    p = T_parent_child[:, :3, 3]
    centre, directions = weighted_scatter(p, np.ones(len(p)))
    plane = directions[:, :2]
    corners = (p[[i, j, k]] - centre) @ plane
    axes = np.column_stack([plane, np.cross(plane[:, 0], plane[:, 1])])
    r = se3.pose(axes, centre + plane @ circumcentre(corners))
    return PaperRevolute(r, se3.inverse(r) @ T_parent_child[i])


def circumcentre(corners: FloatArray) -> FloatArray:
    """(2,) the point equally far from three points (3, 2); their mean if they are on a line."""
    sides = corners[1:] - corners[0]
    longest = float((sides**2).sum(axis=-1).max())
    if abs(float(np.linalg.det(sides))) <= FLATTEST_TRIANGLE * longest:
        return np.asarray(corners.mean(axis=0), dtype=np.float64)
    return np.asarray(corners[0] + np.linalg.solve(2 * sides, (sides**2).sum(axis=-1)), dtype=np.float64)


STARTS: dict[str, Start] = {
    "rigid": start_rigid,
    "prismatic": start_prismatic,
    "revolute": start_revolute,
}
