"""The simulated lab of a rig: its mechanism, plates, boxes and camera, and the picture for given joint angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.intrinsics import CameraModel
from station.drawn import drawn_box, drawn_camera, drawn_colour, drawn_plate
from station.formats.rig import RigTable
from station.formats.simulation import SimulatedBox, SimulatedPlate, SimulationTable, metres
from station.kinematics import se3
from station.logs import FloatArray
from station.mechanism import mechanism
from station.perception.markers import MarkerTable
from station.simulate.render import SceneRenderer
from station.simulate.scene import Box, CameraOptics, Plate

# Parts of the image between whose edges the motion under a rolling shutter is taken to be even. What that leaves out
# is at most an eighth of the acceleration times the part's time squared: 0.015 px at 25 ms of readout, 10 rad/s2 and
# 300 px from the axis.
SHUTTER_BANDS = 4


class Stage:
    """The lab that the rendered camera looks at.

    Args:
        rig: whose joints and markers it shows.
        simulation: the rig's own.
        calibration: of the camera; taken to be the truth where the simulation gives none of its own.
        seed: of the sensor's noise, and of how far the plates and the camera are from where they are drawn.

    Attributes:
        readout_s: true time from the first to the last row; 0 of a global shutter.
        knots_s: (K,) times, from the middle row's on, at which a rolling shutter's picture wants the joints.
    """

    def __init__(self, rig: RigTable, simulation: SimulationTable, calibration: CameraModel, seed: int) -> None:
        self.tree = mechanism(simulation)
        self.joints = tuple(joint.name for joint in rig.joint) or tuple(simulation.units())
        self._bodies = simulation.bodies()
        misplaced = _Misplacement(simulation, seed)
        camera = simulation.camera
        self.T_camera_root = se3.inverse(misplaced(drawn_camera(camera)))
        self.plates = tuple(self._plate(plate, rig.marker_table(), misplaced) for plate in simulation.plate)
        boxes = tuple(self._box(box) for box in simulation.box)
        optics = CameraOptics(
            size_px=calibration.size_px,
            matrix=calibration.matrix if camera.matrix is None else np.array(camera.matrix),
            distortion=calibration.distortion if camera.distortion is None else np.array(camera.distortion),
            blur_px=camera.blur_px,
            noise_grey=camera.noise_grey,
            gamma=camera.gamma,
        )
        self.readout_s = (calibration.readout_s or 0.0) if camera.readout_s is None else camera.readout_s
        bands = SHUTTER_BANDS if self.readout_s else 0
        self.knots_s = (np.arange(bands + 1) / bands - 0.5) * self.readout_s if bands else np.zeros(1)
        self._renderer = SceneRenderer(self.plates, boxes, rig.markers.dictionary, optics, seed)

    def _plate(self, plate: SimulatedPlate, markers: MarkerTable, misplaced: _Misplacement) -> Plate:
        size_m = next(marker.size_m for marker in markers.markers if marker.id == plate.id)
        T_body_marker = misplaced(drawn_plate(plate))
        return Plate(self._bodies.index(plate.body), T_body_marker, size_m, plate.margin_mm / 1e3, plate.id)

    def _box(self, box: SimulatedBox) -> Box:
        return Box(self._bodies.index(box.body), drawn_box(box), metres(box.size_mm), drawn_colour(box))

    def T_camera_bodies(self, q: FloatArray) -> FloatArray:
        """(..., B, 4, 4) true poses of the bodies in the camera for joint angles q (..., J) in the rig's order."""
        poses = self.tree.forward({name: q[..., j] for j, name in enumerate(self.joints)})
        batch = q.shape[:-1]
        return self.T_camera_root @ np.stack([np.broadcast_to(poses[b], (*batch, 4, 4)) for b in self._bodies], axis=-3)

    def render(self, q: FloatArray, index: int) -> NDArray[np.uint8]:
        """(H, W, 3) BGR picture number `index`.

        Joint angles q are (S, K, J), at S instants of the exposure of each of K rows (those of `knots_s`).
        """
        return self._renderer.render(self.T_camera_bodies(q), index)


class _Misplacement:
    """Moves poses a little, each call another draw, as hands would that build what was drawn."""

    def __init__(self, simulation: SimulationTable, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._std: Sequence[float] = [simulation.placement_mm * 1e-3] * 3 + [np.radians(simulation.placement_deg)] * 3

    def __call__(self, T: FloatArray) -> FloatArray:
        return T @ se3.exp(self._rng.normal(size=6) * self._std)
