"""The scene of a rig's [simulation] as a forecast takes it: drawn places, of which hands will be a little off."""

from __future__ import annotations

import numpy as np

from calibration.intrinsics import CameraModel
from station.drawn import drawn_box, drawn_camera, drawn_colour, drawn_plate
from station.foresight.scene import Block, Link, Mount, Scene
from station.formats.rig import RENDERED, RigTable
from station.formats.simulation import MM_PER_M, SimulationTable, metres
from station.kinematics import se3
from station.mechanism import mechanism
from station.perception.markers import cells_along

# Where nobody says how long the shutter is open: what docs/cameras.md asks for.
ASSUMED_EXPOSURE_S = 0.008


def drawn_scene(rig: RigTable, simulation: SimulationTable, camera: CameraModel, *, simulate: bool) -> Scene:
    """The lab as the rig draws it, before its camera, or with `simulate` before the rendered one."""
    markers = {marker.id: marker for marker in rig.marker_table().markers}
    cells = cells_along(rig.markers.dictionary)
    mounts = tuple(
        Mount(
            marker_id=plate.id,
            part=markers[plate.id].part,
            body=plate.body,
            T_body_marker=drawn_plate(plate),
            size_m=markers[plate.id].size_m,
            margin_m=plate.margin_mm / MM_PER_M,
            cells=cells,
        )
        for plate in simulation.plate
    )
    driven = {joint.name for joint in rig.joint}
    exposure_s, notes = exposure(rig, simulate=simulate)
    return Scene(
        tree=mechanism(simulation),
        links={name: Link() for name in simulation.units() if name in driven},
        resting={name: np.zeros(()) for name in simulation.units() if name not in driven},
        T_camera_root={simulation.root: se3.inverse(drawn_camera(simulation.camera))},
        camera=camera,
        exposure_s=exposure_s,
        mounts=mounts,
        blocks=tuple(Block(box.body, drawn_box(box), metres(box.size_mm), drawn_colour(box)) for box in simulation.box),
        notes=(
            "places of markers, boxes and camera are those that the rig's [simulation] draws",
            *notes,
            *unplaced(rig, {mount.marker_id for mount in mounts}, "the rig's [simulation]"),
        ),
    )


def exposure(rig: RigTable, *, simulate: bool) -> tuple[float, tuple[str, ...]]:
    """How long the shutter is open [s], and a note where that is but assumed."""
    rendered = simulate or rig.camera.source == RENDERED
    if rendered and rig.simulation is not None:
        return rig.simulation.camera.exposure_s, ()
    if rig.camera.exposure_ms is not None:
        return rig.camera.exposure_ms / 1e3, ()
    assumed = f"exposure taken to be {1e3 * ASSUMED_EXPOSURE_S:g} ms: the rig has no exposure_ms under [camera]"
    return ASSUMED_EXPOSURE_S, (assumed,)


def unplaced(rig: RigTable, placed: set[int], where: str) -> tuple[str, ...]:
    """A note of the rig's markers whose places are not known, if there are any."""
    missing = [f"{marker.id} ({marker.part})" for marker in rig.marker_table().markers if marker.id not in placed]
    return (f"nothing is known of the places of markers {', '.join(missing)}: {where} has none",) if missing else ()
