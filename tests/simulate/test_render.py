"""SceneRenderer against cv2.projectPoints, OpenCV's own marker detector, and itself drawn in other ways."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
import pytest
from numpy.typing import ArrayLike

from station.errors import InvalidData
from station.logs import FloatArray
from station.simulate import render
from station.simulate.quads import IntArray
from station.simulate.rays import SAMPLES_PX, sample_rays
from station.simulate.render import Box, CameraOptics, Plate, SceneRenderer

DICTIONARY = "DICT_4X4_50"
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)
WEBCAM = (0.05, -0.1, 0.001, -0.0005, 0.02)
STRONG = (-0.35, 0.12, 0.003, -0.002, 0.0)
SIZE_M, MARGIN_M = 0.05, 0.01
EDGE_POINTS = 60
FACING = np.diag([1.0, -1.0, -1.0])  # rotation of a marker that faces the camera, upright
ORANGE = (50, 120, 210)


def optics(
    size_px: tuple[int, int] = (320, 240),
    f_px: float = 300.0,
    distortion: Sequence[float] = NO_DISTORTION,
    blur_px: float = 0.6,
    noise_grey: float = 0.0,
    gamma: float = 1.0,
) -> CameraOptics:
    """A linear camera without noise unless asked otherwise."""
    matrix = np.array([[f_px, 0, (size_px[0] - 1) / 2], [0, f_px, (size_px[1] - 1) / 2], [0, 0, 1]])
    return CameraOptics(size_px, matrix, np.array(distortion), blur_px, noise_grey, gamma)


def pose(t: ArrayLike, turn: ArrayLike = (0, 0, 0)) -> FloatArray:
    """A marker at `t` that faces the camera, then turned by the rotation vector `turn` in its own frame."""
    T = np.eye(4)
    T[:3, :3] = FACING @ cv2.Rodrigues(np.asarray(turn, dtype=np.float64))[0]
    T[:3, 3] = t
    return T


def plate(marker_id: int = 0, body: int = 0) -> Plate:
    return Plate(body, np.eye(4), SIZE_M, MARGIN_M, marker_id)


def box(size_m: Sequence[float], body: int = 0, colour: tuple[int, int, int] = ORANGE) -> Box:
    return Box(body, np.eye(4), np.array(size_m), colour)


def renderer(
    plates: Sequence[Plate], boxes: Sequence[Box] = (), camera: CameraOptics | None = None, seed: int = 1
) -> SceneRenderer:
    return SceneRenderer(plates, boxes, DICTIONARY, camera or optics(), seed)


def empty(camera: CameraOptics) -> np.ndarray:
    return renderer([], [], camera).render(np.zeros((0, 4, 4)), 0)


def projected(points_m: FloatArray, T_cam_body: FloatArray, camera: CameraOptics) -> FloatArray:
    """Pixels (N, 2) of points (N, 3) of a body: the truth."""
    rvec = cv2.Rodrigues(T_cam_body[:3, :3])[0]
    pixels = cv2.projectPoints(points_m, rvec, T_cam_body[:3, 3], camera.matrix, camera.distortion)[0]
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)


def marker_points(per_edge: int) -> FloatArray:
    """Points (4, per_edge, 3) along a marker's edges from its top left corner clockwise, ends left out."""
    corners = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]]) * SIZE_M / 2
    along = np.linspace(0.15, 0.85, per_edge)[:, None]
    return np.array([a + (b - a) * along for a, b in pairwise(corners)])


def edge_errors(image: np.ndarray, T_cam_marker: FloatArray, camera: CameraOptics) -> FloatArray:
    """Mean place (4,) of each edge of a marker in a linear image, px outward of the truth."""
    edges_px = np.array([projected(edge, T_cam_marker, camera) for edge in marker_points(EDGE_POINTS)])
    return errors_of_edges(image, edges_px)


def errors_of_edges(image: np.ndarray, points: FloatArray) -> FloatArray:
    """Mean place (4,) of edges in a linear image, px outward of where their points (4, N, 2) should be.

    A profile across a blurred edge holds as much light as the sharp edge at its true place would.
    """
    reach, step, count = 2.0, 0.25, points.shape[1]
    across = np.arange(-reach, reach + step / 2, step)
    tangent = np.gradient(points, axis=1)
    normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    at = (points[:, :, None] + normal[:, :, None] * across[:, None]).astype(np.float32).reshape(-1, len(across), 2)
    profile = cv2.remap(image[..., 1].astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
    profile = profile.reshape(4, count, -1)
    black = profile[:, :, :2].mean(axis=(1, 2))[:, None, None]
    white = profile[:, :, -2:].mean(axis=(1, 2))[:, None, None]
    inside = np.trapezoid((white - profile) / (white - black), dx=step, axis=-1)
    return inside.mean(axis=1) - reach


def detected(image: np.ndarray) -> dict[int, FloatArray]:
    """Corners (4, 2) of each marker that OpenCV's detector finds with its default parameters."""
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    corners, ids, _ = cv2.aruco.ArucoDetector(book, cv2.aruco.DetectorParameters()).detectMarkers(image)
    found = [] if ids is None else np.ravel(ids).tolist()
    return {int(k): np.reshape(c, (4, 2)).astype(np.float64) for k, c in zip(found, corners, strict=True)}


def six_poses(rng: np.random.Generator, tilt_rad: tuple[float, float], upright: bool) -> FloatArray:
    """Poses (6, 4, 4) of markers side by side at 0.5 to 0.65 m."""
    poses = np.empty((6, 4, 4))
    for k in range(6):
        direction, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(*tilt_rad)
        roll = np.eye(4)
        roll[:3, :3] = cv2.Rodrigues(np.array([0, 0, 0.0 if upright else rng.uniform(-np.pi, np.pi)]))[0]
        x, y = (k % 3 - 1) * 0.15 + rng.uniform(-0.02, 0.02), (k // 3 - 0.5) * 0.2 + rng.uniform(-0.02, 0.02)
        tilted = pose((x, y, rng.uniform(0.5, 0.65)), (tilt * np.cos(direction), tilt * np.sin(direction), 0))
        poses[k] = tilted @ roll
    return poses


@pytest.mark.parametrize(
    ("distortion", "tilt_deg", "upright"),
    [
        (NO_DISTORTION, (0, 0), True),  # edges along rows and columns: the worst case for samples
        (NO_DISTORTION, (0, 50), False),
        (WEBCAM, (0, 50), False),
        (STRONG, (0, 50), False),
    ],
)
def test_edges_lie_where_project_points_says(
    distortion: Sequence[float], tilt_deg: tuple[float, float], upright: bool
) -> None:
    camera = optics((640, 480), 600.0, distortion, blur_px=0.4)
    drawn = renderer([plate(k, k) for k in range(6)], camera=camera)
    rng = np.random.default_rng(3)
    errors: list[FloatArray] = []
    for frame in range(8):
        T_cam_body = six_poses(rng, (np.deg2rad(tilt_deg[0]), np.deg2rad(tilt_deg[1])), upright)
        image = drawn.render(T_cam_body, frame)
        errors += [edge_errors(image, T, camera) for T in T_cam_body]
    # px. A tenth of the 0.05 px that the best corner detectors reach; the largest is one edge's own sampling.
    assert abs(np.mean(errors)) < 0.003
    assert np.sqrt(np.mean(np.square(errors))) < 0.012
    assert np.abs(errors).max() < 0.06


@pytest.mark.parametrize("distortion", [NO_DISTORTION, WEBCAM, STRONG])
def test_the_detector_finds_every_marker_at_its_projected_corners(distortion: Sequence[float]) -> None:
    camera = optics((640, 480), 600.0, distortion, noise_grey=1.0)
    drawn = renderer([plate(k, k) for k in range(6)], camera=camera)
    corners = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * SIZE_M / 2
    rng = np.random.default_rng(4)
    errors: list[FloatArray] = []
    for frame in range(6):
        T_cam_body = six_poses(rng, (0, np.deg2rad(50)), upright=False)
        found = detected(drawn.render(T_cam_body, frame))
        assert sorted(found) == list(range(6))
        errors += [found[k] - projected(corners, T_cam_body[k], camera) for k in range(6)]
    # px. Without refinement OpenCV's corners lie 0.5 px inside their marker, evenly: on average there is no shift.
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.1
    assert np.sqrt(np.mean(np.square(errors))) < 0.8


@pytest.mark.parametrize("distortion", [NO_DISTORTION, WEBCAM, STRONG])
def test_rays_project_back_to_their_samples(distortion: Sequence[float]) -> None:
    camera = optics(distortion=distortion)
    x, y = sample_rays(camera)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)[::7, ::7]
    pixels = projected(rays.reshape(-1, 3), np.eye(4), camera).reshape(*rays.shape[:2], 2)
    rows, columns = np.meshgrid(np.arange(480)[::7], np.arange(640)[::7], indexing="ij")
    truth = np.stack([columns // 2, rows // 2], axis=-1) + SAMPLES_PX[rows % 2, columns % 2]
    np.testing.assert_allclose(pixels, truth, atol=1e-8)  # px


def test_beyond_the_fold_of_a_barrel_there_is_only_the_wall() -> None:
    camera = optics(f_px=150.0, distortion=(-0.4, 0, 0, 0, 0))
    x, _ = sample_rays(camera)
    lost = np.all(np.isnan(x).reshape(240, 2, 320, 2), axis=(1, 3))
    assert lost[0, 0] and not lost[120, 160]
    far_beyond = cv2.erode(lost.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)  # out of the blur's reach
    image = renderer([], [box((9, 9, 0.1))], camera).render(pose((0, 0, 0.5))[None], 0)
    np.testing.assert_array_equal(image[far_beyond], empty(camera)[far_beyond])
    assert np.all(image[120, 160] != empty(camera)[120, 160])


def test_a_plate_is_seen_from_its_front_only() -> None:
    camera = optics()
    drawn = renderer([plate()], camera=camera)
    front, back = pose((0, 0, 0.3)), pose((0, 0, 0.3), (0, np.pi, 0))
    assert list(detected(drawn.render(front[None], 0))) == [0]
    np.testing.assert_array_equal(drawn.render(back[None], 0), empty(camera))


def test_the_nearer_of_two_hides_the_other() -> None:
    drawn = renderer([plate(body=0)], [box((0.1, 0.1, 0.02), body=1)])
    front, behind = pose((0.02, 0, 0.25)), pose((0.02, 0, 0.5))
    T_marker = pose((0.02, 0, 0.4))
    hidden = drawn.render(np.array([T_marker, front]), 0)
    assert detected(hidden) == {}
    blue, _, red = hidden[120, 165]
    assert red > 2 * blue
    assert list(detected(drawn.render(np.array([T_marker, behind]), 0))) == [0]


def test_a_crossing_box_hides_the_part_behind_it() -> None:
    drawn = renderer([plate(body=0)], [box((0.06, 0.3, 0.02), body=1)])
    image = drawn.render(np.array([pose((0, 0, 0.3), (0, 0.8, 0)), pose((0, 0, 0.3))]), 0).astype(int)
    orange = image[120, :, 2] > 2 * image[120, :, 0]
    # The plate, turned about the vertical, meets the plane of the box's front (z = 0.29 m) at x = -0.01 / tan(0.8):
    # in column 149.5. Left of it the plate is nearer, right of it the box.
    assert not orange[137:147].any()
    assert orange[152:188].all()


def test_a_plate_flush_on_a_box_shows_whole() -> None:
    T_box_plate = np.eye(4)
    T_box_plate[2, 3] = 0.02
    flush = Plate(0, T_box_plate, SIZE_M, MARGIN_M, 3)
    for turn in (0.0, 0.3, 0.7):
        T = pose((0, 0, 0.3), (turn, turn, 0))[None]
        on_box = renderer([flush], [box((0.08, 0.08, 0.04))]).render(T, 0)
        assert list(detected(on_box)) == [3]


def test_faces_of_a_box_differ_in_light() -> None:
    image = renderer([], [box((0.1, 0.1, 0.1))]).render(pose((0, 0, 0.5), (0.5, 0.6, 0))[None], 0)
    levels = {tuple(int(v) // 4 for v in pixel) for pixel in image[100:140, 140:180].reshape(-1, 3)[:, 1:2]}
    assert len(levels) >= 2


def moving_scene(frame: int) -> FloatArray:
    """Poses (3, 4, 4): a body at rest, one that moves now and then, one that moves always."""
    return np.array([
        pose((-0.1, 0, 0.5)),
        pose((0.1, 0.01 * (frame // 3), 0.45), (0.2, 0.1, 0)),
        pose((0, 0, 0.4), (0, 0.1 * frame, 0.05 * frame)),
    ])  # fmt: skip


def moving_renderer(seed: int = 1) -> SceneRenderer:
    camera = optics((160, 120), 150.0, WEBCAM, noise_grey=2.0, gamma=2.2)
    return renderer([plate(k, k) for k in range(3)], [box((0.09, 0.09, 0.03), k) for k in range(3)], camera, seed)


def test_a_frame_is_the_same_in_whatever_order_and_however_cached() -> None:
    fresh = [moving_renderer().render(moving_scene(k), k) for k in range(9)]  # nothing cached
    one = moving_renderer()
    order = [*range(9), 8, 8, 3, 4, 0, 7, 7, 1]
    for k in order:
        np.testing.assert_array_equal(one.render(moving_scene(k), k), fresh[k], err_msg=f"frame {k}")


def test_a_blurred_frame_is_the_same_however_cached() -> None:
    def instants(frame: int) -> FloatArray:
        return np.array([moving_scene(frame), moving_scene(frame), moving_scene(frame + 1)])

    one = moving_renderer()
    one.render(moving_scene(0), 0)
    for k in (0, 1, 2, 3, 3, 1):
        np.testing.assert_array_equal(one.render(instants(k), k), moving_renderer().render(instants(k), k))


def test_regions_of_interest_cut_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = optics((160, 120), 120.0, STRONG)
    rng = np.random.default_rng(6)
    scenes: list[FloatArray] = []
    for _ in range(25):
        turn = rng.normal(size=3)
        scenes.append(np.array([pose(rng.uniform((-0.4, -0.3, -0.2), (0.4, 0.3, 0.5)), turn) for _ in range(3)]))
    parts = [plate(k, k) for k in range(3)], [box((0.3, 0.1, 0.2), k) for k in range(3)]
    drawn = renderer(*parts, camera)
    cut = [drawn.render(scene, 0) for scene in scenes]

    def whole_image(T_cam_quad: FloatArray, *_: object) -> IntArray:
        return np.tile(np.array([0, 0, 160, 120]), (len(T_cam_quad), 1))

    monkeypatch.setattr(render, "regions", whole_image)
    uncut = renderer(*parts, camera)
    for scene, image in zip(scenes, cut, strict=True):
        np.testing.assert_array_equal(uncut.render(scene, 0), image)


def test_a_plate_that_leaves_the_image_is_cut_at_the_border(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render, "FALLOFF", 0.0)  # it goes with the image's size
    wide, narrow = optics((320, 240)), optics((160, 240))  # the narrow one sees the middle of the wide one
    in_wide, in_narrow, wall = renderer([plate()], camera=wide), renderer([plate()], camera=narrow), empty(wide)
    for x in np.linspace(0.05, 0.13, 9):
        T = pose((x, 0, 0.3), (0.2, 0.4, 0.1))[None]
        large, small = in_wide.render(T, 0), in_narrow.render(T, 0)
        covered = np.any(large != wall, axis=-1)[:, 80:240]
        covered = cv2.erode(covered.astype(np.uint8), np.ones((7, 7), np.uint8)).astype(bool)
        covered[:, -4:] = False  # the blur's reach from the border
        # One grey level: the two cameras' rays differ in their last bit.
        np.testing.assert_allclose(small[covered].astype(int), large[:, 80:240][covered].astype(int), atol=1)


def test_what_is_behind_the_camera_is_not_drawn() -> None:
    camera = optics()
    drawn, wall = renderer([plate()], [box((0.1, 0.1, 0.1))], camera), empty(camera)
    for T in (pose((0, 0, -0.3)), pose((0, 0, -0.3), (0, np.pi, 0)), pose((3, 0, 0.3)), pose((0, 0, -1e-4))):
        np.testing.assert_array_equal(drawn.render(T[None], 0), wall)


def test_a_table_that_runs_past_the_camera_ends_at_its_horizon() -> None:
    camera = optics()
    table = Box(0, np.eye(4), np.array([40.0, 0.02, 40.0]), ORANGE)
    T = np.eye(4)
    T[1, 3] = 0.3  # its top is 0.29 m below the camera and level with it: it reaches z = 20 m, 4.4 px below the middle
    image = renderer([], [table], camera).render(T[None], 0).astype(int)
    np.testing.assert_array_equal(image[:120], empty(camera)[:120])
    below = image[130:]
    assert np.all(below[..., 2] > 2 * below[..., 0])


def test_noise_has_the_sigma_asked_for_and_is_new_in_each_frame() -> None:
    sigma = 3.0
    drawn = renderer([], camera=optics(noise_grey=sigma))
    clean = renderer([]).render(np.zeros((0, 4, 4)), 0).astype(float)
    frames = np.array([drawn.render(np.zeros((0, 4, 4)), k) for k in range(4)], dtype=float)
    noise = frames - clean
    rounding = 1 / 12 * 2  # grey levels squared: of the noisy frame and of the clean one
    # 230400 samples: the standard deviation of sigma is 0.15 %, of the mean 0.006.
    np.testing.assert_allclose(noise.std(axis=(1, 2, 3)), np.sqrt(sigma**2 + rounding), rtol=0.01)
    np.testing.assert_allclose(noise.mean(axis=(1, 2, 3)), 0, atol=0.05)
    for first, second in pairwise(noise):
        assert abs(np.mean(first * second)) < 0.1
    for axis in range(3):
        neighbours = np.mean(np.diff(noise, axis=axis + 1) ** 2) / (2 * np.mean(noise**2))
        assert neighbours == pytest.approx(1, abs=0.02)  # 1 for white noise
    other = renderer([], camera=optics(noise_grey=sigma), seed=2).render(np.zeros((0, 4, 4)), 0)
    assert abs(np.mean((other - clean) * noise[0])) < 0.1


def test_gamma_comes_after_the_blur() -> None:
    T = pose((0, 0, 0.3), (0.3, 0.2, 0.1))[None]
    linear = renderer([plate()], camera=optics(blur_px=1.5)).render(T, 0).astype(float)
    curved = renderer([plate()], camera=optics(blur_px=1.5, gamma=2.2)).render(T, 0).astype(float)
    expected = 255 * (linear / 255) ** (1 / 2.2)
    # Half a grey level of the linear image is 1.5 where the curve is steepest (black print), and half from rounding.
    np.testing.assert_allclose(curved, expected, atol=2.5)


def test_blur_has_the_sigma_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render, "FALLOFF", 0.0)  # its steps of a grey level far from the edge would weigh

    def edge_variance(blur_px: float) -> float:
        image = renderer([plate()], camera=optics(blur_px=blur_px)).render(pose((0, 0, 0.12))[None], 0).astype(float)
        edge = -np.diff(image[120, 78:116, 1])  # from the white margin to the black border
        edge /= edge.sum()
        x = np.arange(len(edge))
        return float(np.sum(edge * (x - np.sum(edge * x)) ** 2))

    # px squared. What samples and pixels add is in both; grey levels cut the tails at 0.3 %.
    assert edge_variance(1.6) - edge_variance(0.6) == pytest.approx(1.6**2 - 0.6**2, rel=0.03)


def test_instants_are_averaged_in_light() -> None:
    first, second = pose((0, 0, 0.3))[None], pose((0.01, 0, 0.3))[None]
    drawn = renderer([plate()])
    mean = (drawn.render(first, 0).astype(float) + drawn.render(second, 0)) / 2
    np.testing.assert_allclose(drawn.render(np.array([first, second]), 0), mean, atol=1.01)  # two roundings
    still = drawn.render(np.array([first, first, first]), 0)
    np.testing.assert_array_equal(still, drawn.render(first, 0))


def test_the_light_dims_and_saturates() -> None:
    T = pose((0, 0, 0.3))[None]
    matrix, distortion = optics().matrix, optics().distortion
    white = []
    for light in (0.5, 1.0, 5.0):
        camera = CameraOptics((320, 240), matrix, distortion, noise_grey=0, gamma=1, light=light)
        white.append(int(renderer([plate()], camera=camera).render(T, 0)[120 - 29, 160, 1]))
    assert white[0] == pytest.approx(white[1] / 2, abs=1)
    assert white[2] > 240


@pytest.mark.parametrize(
    ("marker_id", "dictionary", "message"),
    [(50, DICTIONARY, "markers 0 to 49; have marker 50"), (0, "DICT_9X9", "no marker dictionary 'DICT_9X9'; have")],
)
def test_a_marker_that_does_not_exist_is_refused(marker_id: int, dictionary: str, message: str) -> None:
    with pytest.raises(InvalidData, match=message):
        SceneRenderer([plate(marker_id)], [], dictionary, optics(), 0)


def test_poses_that_do_not_fit_are_refused() -> None:
    drawn = renderer([plate(body=1)])
    with pytest.raises(InvalidData, match="poses of 1 bodies; the scene has 2"):
        drawn.render(np.eye(4)[None], 0)
    with pytest.raises(InvalidData, match=r"shape \(4, 4\)"):
        drawn.render(np.eye(4), 0)
    with pytest.raises(InvalidData, match="no rigid motion"):
        drawn.render(np.array([np.eye(4), np.eye(4) * np.nan]), 0)


def test_values_that_make_no_scene_are_refused() -> None:
    camera = optics()
    with pytest.raises(InvalidData, match="size > 0"):
        Plate(0, np.eye(4), 0.0, 0.01, 0)
    with pytest.raises(InvalidData, match="body -1"):
        Plate(-1, np.eye(4), 0.05, 0.01, 0)
    with pytest.raises(InvalidData, match="no rigid motion"):
        Plate(0, 2 * np.eye(4), 0.05, 0.01, 0)
    with pytest.raises(InvalidData, match="three positive lengths"):
        Box(0, np.eye(4), np.array([0.1, 0.1, 0.0]), ORANGE)
    with pytest.raises(InvalidData, match="0 to 255"):
        Box(0, np.eye(4), np.ones(3), (0, 0, 256))
    with pytest.raises(InvalidData, match="shapes are"):
        CameraOptics((4, 4), camera.matrix, np.zeros(4))
    with pytest.raises(InvalidData, match="gamma above 0"):
        CameraOptics((4, 4), camera.matrix, camera.distortion, gamma=0)
    with pytest.raises(InvalidData, match="want the matrix"):
        CameraOptics((4, 4), camera.matrix.T, camera.distortion)
