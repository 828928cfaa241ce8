"""The tree in space: bodies, the ways they went, the joints' axes, the camera; seen from where it is told best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from station.logs import FloatArray, JointLog
from station.report.labels import place_labels
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.tables import own_name, shortened
from station.report.view_direction import view_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from station.kinematics.tree import Joint, KinematicTree

HEIGHT_IN = 5.2
# Rows of the states at which the bodies' ways are drawn.
WAY_ROWS = 240
# Parts of the scene's extent: half an axis, a body's own axes, the camera's depth.
AXIS_SHARE, FRAME_SHARE, CAMERA_SHARE = 0.16, 0.07, 0.1
LEAST_EXTENT_M = 0.02
# Of the panel's width or height, at each end.
MARGIN = 0.08
# A camera's picture is about this wide and high for its depth.
CAMERA_HALF = np.array([0.5, 0.375])
SCALES_M = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
FRAME_COLOURS = (LIGHT.detected, LIGHT.viewing, LIGHT.measured)


@dataclass(frozen=True, eq=False)
class _Scene:
    """One tree at one moment, in its root's frame.

    Attributes:
        T_root_body: (4, 4) by body.
        ways_m: (N, 3) where each body went; NaN where unknown.
        axes: by joint, a point of it and its unit vector in the root's frame; None for a joint without one.
    """

    tree: KinematicTree
    root: str
    T_root_body: dict[str, FloatArray]
    ways_m: dict[str, FloatArray]
    axes: dict[str, tuple[FloatArray, FloatArray | None]]
    T_root_camera: FloatArray | None

    @property
    def joints(self) -> list[Joint]:
        return [joint for joint in self.tree.joints if joint.parent in self.T_root_body]

    @property
    def extent_m(self) -> float:
        """The longest side of what moves or stands, the camera left out."""
        points = np.concatenate([*self.ways_m.values(), *(T[None, :3, 3] for T in self.T_root_body.values())])
        return max(float(np.nanmax(np.ptp(_known(points), axis=0))), LEAST_EXTENT_M)


def space_figure(tree: KinematicTree, states: JointLog, T_root_camera: FloatArray | None) -> Figure:
    """The bodies of each tree at a typical moment, side by side where there are several trees.

    A box for each body at its named part, with its axes (x orange, y green, z blue), and the way it went in the root's
    frame; the joints' axes through their points; the camera, where it is known, of the root's tree.

    Args:
        states: of the tree's joints.
        T_root_camera: (4, 4) in the frame of `tree.root`.
    """
    from matplotlib.figure import Figure

    roots = sorted(tree.tree_roots, key=lambda name: name != tree.root)
    with styled():
        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
        for column, root in enumerate(roots):
            width = 1 / len(roots)
            axes = figure.add_axes((column * width, 0.0, width, 1.0))
            draw_space(axes, tree, states, root, T_root_camera if root == tree.root else None)
        return figure


def draw_space(
    axes: Axes, tree: KinematicTree, states: JointLog, root: str, T_root_camera: FloatArray | None = None
) -> None:
    """One panel of `space_figure`: the bodies that hang from `root`."""
    _draw(axes, _scene(tree, states, root, T_root_camera))


def _scene(tree: KinematicTree, states: JointLog, root: str, T_root_camera: FloatArray | None) -> _Scene:
    q = states.q[:, [states.joints.index(column) for column in tree.columns]]
    at = _typical(q)
    T_root_body = tree.forward(at, start=root)
    thinned = q[:: max(1, len(q) // WAY_ROWS)]
    ways = {body: T[..., :3, 3].reshape(-1, 3) for body, T in tree.forward(thinned, start=root).items()}
    axes: dict[str, tuple[FloatArray, FloatArray | None]] = {}
    for joint in tree.joints:
        if joint.parent in T_root_body:
            T = T_root_body[joint.parent]
            point = T_root_body[joint.child][:3, 3]
            if joint.point_parent_m is not None:
                point = T[:3, :3] @ joint.point_parent_m + T[:3, 3]
            axes[joint.name] = point, None if joint.axis_parent is None else T[:3, :3] @ joint.axis_parent
    return _Scene(tree, root, T_root_body, ways, axes, T_root_camera)


def _typical(q: FloatArray) -> FloatArray:
    """(C,) the states of the row nearest to the middle of all, unknown ones at their middle, else zero."""
    if not q.size:
        return np.zeros(q.shape[1])
    middle = np.array([np.median(known) if len(known := column[np.isfinite(column)]) else 0.0 for column in q.T])
    spread = np.array([np.ptp(known) if len(known := column[np.isfinite(column)]) else 0.0 for column in q.T])
    off = np.abs(q - middle) / np.where(spread > 0, spread, 1.0)
    row = int(np.argmin(np.sum(np.where(np.isfinite(off), off, 1.0), axis=1)))
    return np.where(np.isfinite(q[row]), q[row], middle)


def _known(points: FloatArray) -> FloatArray:
    return points[np.isfinite(points).all(axis=1)]


def _draw(axes: Axes, scene: _Scene) -> None:
    view = _view(scene)
    axes.set_axis_off()
    extent_m = scene.extent_m
    for body, way in scene.ways_m.items():
        if body != scene.root:
            axes.plot(*(way @ view[:2].T).T, color=LIGHT.faint, lw=1.6, zorder=1)
    ways = len(axes.get_lines())
    _draw_links(axes, scene, view)
    labels = _draw_axes(axes, scene, view, AXIS_SHARE * extent_m)
    labels += _draw_bodies(axes, scene, view, FRAME_SHARE * extent_m)
    if scene.T_root_camera is not None:
        labels += _draw_camera(axes, scene.T_root_camera, view, CAMERA_SHARE * extent_m)
    _fit_limits(axes)
    _draw_scale(axes, extent_m)
    place_labels(axes, labels, [np.asarray(line.get_xydata(), float) for line in axes.get_lines()[ways:]])


def _fit_limits(axes: Axes) -> None:
    """All that is drawn, with a margin, and both directions in one scale."""
    box, panel = axes.dataLim, axes.get_window_extent()
    scale = max(box.width / panel.width, box.height / panel.height) / (1 - 2 * MARGIN)
    for centre, size, limit in (
        ((box.x0 + box.x1) / 2, panel.width, axes.set_xlim),
        ((box.y0 + box.y1) / 2, panel.height, axes.set_ylim),
    ):
        limit(centre - scale * size / 2, centre + scale * size / 2)


def _view(scene: _Scene) -> FloatArray:
    """From near the camera, which is upright; without one, the root's marker is taken to hang upright."""
    T = scene.T_root_camera
    up = np.array([0.0, 1.0, 0.0]) if T is None else -T[:3, 1]
    middle = np.mean([T[:3, 3] for T in scene.T_root_body.values()], axis=0)
    towards = None if T is None else T[:3, 3] - middle
    links = [scene.T_root_body[j.child][:3, 3] - scene.T_root_body[j.parent][:3, 3] for j in scene.joints]
    along = [axis for _, axis in scene.axes.values() if axis is not None]
    return view_axes(np.array([*links, *along, up]), up, towards)


def _draw_links(axes: Axes, scene: _Scene, view: FloatArray) -> None:
    """From the parent's part to the joint and on to the child's part."""
    for joint in scene.joints:
        ends = [scene.T_root_body[name][:3, 3] for name in (joint.parent, joint.child)]
        corners = np.array([ends[0], scene.axes[joint.name][0], ends[1]])
        axes.plot(*(corners @ view[:2].T).T, color=LIGHT.commanded, lw=1.6, zorder=2, solid_joinstyle="round")


def _draw_axes(axes: Axes, scene: _Scene, view: FloatArray, half_m: float) -> list[tuple[FloatArray, str, str]]:
    """An arrow along each axis, dashed for what slides; a ring for a joint without one that moves."""
    labels: list[tuple[FloatArray, str, str]] = []
    for joint in scene.joints:
        point, axis = scene.axes[joint.name]
        at = view[:2] @ point
        name = shortened(own_name(joint) or joint.type, 20)
        if axis is None:
            if joint.kind.states:
                axes.plot(*at, "o", mfc="none", mec=LIGHT.detected, mew=1.6, ms=12, zorder=4)
                labels.append((at, name, LIGHT.detected))
            continue
        tip, tail = (view[:2] @ (point + sign * half_m * axis) for sign in (1.0, -1.0))
        slides = joint.type == "prismatic"
        style = "<|-|>" if slides else "-|>"
        arrow = {"arrowstyle": style, "color": LIGHT.detected, "lw": 1.8, "ls": (0, (4, 1.5)) if slides else "solid"}
        axes.annotate("", tuple(tip), tuple(tail), arrowprops=arrow | {"shrinkA": 0, "shrinkB": 0}, zorder=4)
        axes.plot(*np.transpose([tip, tail]), lw=0)  # so that the limits take the arrow in
        labels.append((tip, name, LIGHT.detected))
    return labels


def _draw_bodies(axes: Axes, scene: _Scene, view: FloatArray, length_m: float) -> list[tuple[FloatArray, str, str]]:
    labels: list[tuple[FloatArray, str, str]] = []
    for body, T in scene.T_root_body.items():
        at = view[:2] @ T[:3, 3]
        for column, colour in enumerate(FRAME_COLOURS):
            end = view[:2] @ (T[:3, 3] + length_m * T[:3, column])
            axes.plot(*np.transpose([at, end]), color=colour, lw=1.6, zorder=3)
        axes.plot(*at, "s", color=LIGHT.ink, ms=4.5, zorder=5)
        labels.append((at, shortened(body, 24), LIGHT.ink))
    return labels


def _draw_camera(axes: Axes, T: FloatArray, view: FloatArray, depth_m: float) -> list[tuple[FloatArray, str, str]]:
    """A pyramid that opens towards what the camera sees."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * CAMERA_HALF * depth_m
    seen = np.column_stack([corners, np.full(5, depth_m)])
    rim = (seen @ T[:3, :3].T + T[:3, 3]) @ view[:2].T
    eye = view[:2] @ T[:3, 3]
    axes.plot(*rim.T, color=LIGHT.viewing, lw=1.2, zorder=3)
    for corner in rim[:4]:
        axes.plot(*np.transpose([eye, corner]), color=LIGHT.viewing, lw=1.0, zorder=3)
    return [(eye, "camera", LIGHT.viewing)]


def _draw_scale(axes: Axes, extent_m: float) -> None:
    """A bar of a round length at the lower left."""
    length_m = min(SCALES_M, key=lambda each: abs(np.log(each / (0.25 * extent_m))))
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    x, y = left + 0.03 * (right - left), bottom + 0.03 * (top - bottom)
    axes.plot([x, x + length_m], [y, y], color=LIGHT.ink, lw=2.0)
    axes.text(x + length_m + 0.01 * (right - left), y, f"{1e3 * length_m:g} mm", fontsize=8, va="center")
