"""What hides a marker, against the renderer's own picture of the same scene."""

from __future__ import annotations

import numpy as np
import pytest

from station.foresight.forecast import foresee
from station.foresight.hiding import hidden_by
from station.foresight.scene import Scene
from station.foresight.sight import sight
from station.kinematics import se3
from station.simulate.render import Box, CameraOptics, Plate, SceneRenderer
from tests.foresight.scenes import CAMERA, DISTANCE_M, FACING, SIZE_M, at, block, mount, plan, scene

STILL = {"joint": np.zeros((3, 1))}


def hidden(made: Scene) -> np.ndarray:
    poses = made.T_camera_bodies({"joint": np.zeros(1)})
    seen = sight(made, STILL)
    return hidden_by(made, poses, seen.T_camera_marker, np.ones((1, len(made.mounts)), bool))[0] >= 0


def covered_share(made: Scene) -> float:
    """Of the pixels inside the marker's square, how many show something else when the boxes are there."""
    small = CAMERA.scaled_to((320, 240))
    optics = CameraOptics(small.size_px, small.matrix, small.distortion, blur_px=0.0, noise_grey=0.0)
    bodies = made.bodies
    plates = [Plate(bodies.index(m.body), m.T_body_marker, m.size_m, m.margin_m, m.marker_id) for m in made.mounts]
    boxes = [Box(bodies.index(b.body), b.T_body_block, b.size_m, (0, 255, 0)) for b in made.blocks or ()]
    poses = made.T_camera_bodies({"joint": np.zeros(())})
    T = np.stack([poses[body] for body in bodies])
    with_boxes, without = (SceneRenderer(plates, b, "DICT_4X4_50", optics, 0).render(T, 0) for b in (boxes, []))
    changed = np.any(with_boxes != without, axis=-1)
    corners = (sight(made, STILL).corners_px[0, 0] - 0.5) / 2
    v, u = np.mgrid[:240, :320]
    edges = np.roll(corners, -1, axis=0) - corners
    side = edges[:, 0] * (v[..., None] - corners[:, 1]) - edges[:, 1] * (u[..., None] - corners[:, 0])
    inside = np.all(side > 1, axis=-1) | np.all(side < -1, axis=-1)
    return float(changed[inside].mean())


def test_a_marker_is_hidden_where_the_renderer_shows_something_else_of_it():
    """Boxes at random before, beside and behind a marker; those that touch it by less than 2 % are left to taste."""
    rng = np.random.default_rng(3)
    outcomes: list[bool] = []
    for _ in range(60):
        turn = se3.pose(se3.exp_so3(rng.normal(size=3) * 0.5), np.zeros(3))
        where = at(*rng.uniform((-0.09, -0.09, -0.4), (0.09, 0.09, 0.1)))
        box = block("base", where @ se3.pose(se3.exp_so3(rng.normal(size=3)), np.zeros(3)), rng.uniform(0.01, 0.08, 3))
        made = scene(mounts=[mount(0, "base", turn @ FACING)], blocks=[box])
        share = covered_share(made)
        if share == 0.0 or share > 0.02:
            # Bare of what is only near: the rim around the square is asked for, too.
            if share == 0.0 and hidden(made)[0]:
                assert covered_share(wider(made)) > 0
                continue
            assert hidden(made)[0] == (share > 0), (share, box.size_m, where)
            outcomes.append(share > 0)
    assert 10 < sum(outcomes) < len(outcomes) - 10


def wider(made: Scene) -> Scene:
    """The same with the square as large as what the detector needs around it, which is a little more than its rim."""
    (only,) = made.mounts
    large = type(only)(only.marker_id, only.part, only.body, only.T_body_marker, 1.25 * SIZE_M, 0.0, only.cells)
    return scene(mounts=[large], blocks=made.blocks or ())


def test_a_box_behind_a_marker_and_one_flush_with_it_hide_nothing():
    behind = block("base", at(0, 0, 0.1), (0.2, 0.2, 0.05))
    flush = block("base", at(0, 0, 0.025), (0.2, 0.2, 0.05))
    assert not hidden(scene(mounts=[mount(0, "base", FACING)], blocks=[behind, flush])).any()


def test_a_box_that_the_camera_is_in_hides_nothing():
    around = block("base", at(0, 0, -DISTANCE_M), (0.3, 0.3, 0.3))
    assert not hidden(scene(mounts=[mount(0, "base", FACING)], blocks=[around])).any()


def test_a_plate_hides_the_marker_behind_it_and_not_itself():
    made = scene(mounts=[mount(0, "base", FACING), mount(1, "arm", at(0.01, 0, -0.1) @ FACING)])
    assert hidden(made).tolist() == [True, False]


def test_the_white_of_a_plate_may_cover_white():
    """Its rim ends where the other's square begins, and doesn't hide it; over the square it would."""
    rim_m = SIZE_M / 2 + SIZE_M / 6
    apart_m = (SIZE_M / 2 + 1e-4) + rim_m
    before = mount(1, "arm", at(apart_m, 0, -0.0015) @ FACING)
    assert hidden(scene(mounts=[mount(0, "base", FACING), before])).tolist() == [False, False]
    before = mount(1, "arm", at(apart_m - 0.005, 0, -0.0015) @ FACING)
    assert hidden(scene(mounts=[mount(0, "base", FACING), before])).tolist() == [True, False]


def test_the_forecast_says_whose_box_it_is():
    made = scene(
        mounts=[mount(0, "base", at(-0.2, 0, 0) @ FACING), mount(1, "arm", at(0.0, 0, 0) @ FACING)],
        blocks=[block("base", at(0, 0, -0.2), (0.02, 0.2, 0.02))],
    )
    forecast = foresee(plan(0.1), made, np.array([0.0, 0.1]))
    assert forecast.why(0, 1) == "hidden by base"
    assert forecast.seen[:, 0].all()


@pytest.mark.parametrize("size_m", [(0.02, 0.2, 0.02), (0.2, 0.02, 0.02)])
def test_a_bar_across_a_marker_hides_it(size_m: tuple[float, float, float]):
    bar = block("base", at(0, 0, -0.05), size_m)
    assert hidden(scene(mounts=[mount(0, "base", FACING)], blocks=[bar])).all()
