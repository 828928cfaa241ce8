"""What a motion will do and what the camera will see of it, before anything moves: `station plan` and `--dry-run`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from station.commands.planning import planned_motion, room_remarks
from station.errors import StationError
from station.foresight.detector import HIDDEN, SMEARED
from station.foresight.forecast import Forecast, foresee, frame_times_s
from station.foresight.joints import JointOutlook, joint_outlooks
from station.foresight.remarks import forecast_remarks
from station.logs import FloatArray
from station.motion import Plan

if TYPE_CHECKING:
    from station.foresight.scene import Scene
    from station.rig import RigFile

PICTURE = "plan"


@dataclass(frozen=True, eq=False)
class Outlook:
    """A planned motion, checked against the rig, and what will be seen of it.

    Attributes:
        plan: what will be commanded when.
        dictionary: of the rig's markers.
        forecast: None where nothing is known of the mechanism or its markers.
        joints: of the forecast.
        warnings: what is doubtful, in words.
        notes: what the forecast rests on, or what it lacks.
    """

    plan: Plan
    dictionary: str
    forecast: Forecast | None
    joints: tuple[JointOutlook, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]


def foresee_motion(
    rig: str,
    motion: str,
    *,
    tree: Path | None = None,
    simulate: bool = False,
    folder: Path | None = None,
    frames: str = "jpeg",
) -> Outlook:
    """Lay out a motion on a rig, check all of it, and foresee what the camera will see; opens no device.

    Args:
        rig, motion: names of packaged ones, or paths.
        tree: a fitted session whose mechanism, markers and camera are taken, in place of the rig's [simulation].
        simulate: as for a capture.
        folder: where it would be recorded, to see whether there is room; the current one if None.
        frames: how images would be kept, as for a capture.

    Raises:
        StationError: a bad rig or motion, one that goes over a limit, a session that isn't fitted.
    """
    from station.rig import check_simulated, load_rig

    rig_file = load_rig(rig)
    check_simulated(rig_file, simulate)
    plan = planned_motion(rig_file, motion)[0]
    dictionary, room = rig_file.table.markers.dictionary, room_remarks(rig_file, plan, folder or Path.cwd(), frames)
    scene, lacking = _scene(rig_file, tree, simulate=simulate)
    if scene is None or not scene.mounts:
        notes = (*lacking, *(scene.notes if scene else ()))
        return Outlook(plan, dictionary, None, (), room, notes)
    forecast = foresee(plan, scene, frame_times_s(plan.duration_s, rig_file.table.camera.fps))
    joints = joint_outlooks(forecast)
    warnings = (*forecast_remarks(forecast, joints), *room)
    return Outlook(plan, dictionary, forecast, joints, warnings, scene.notes)


def _scene(rig: RigFile, tree: Path | None, *, simulate: bool) -> tuple[Scene | None, tuple[str, ...]]:
    if tree is not None:
        from station.commands.fitted_scene import fitted_scene

        return fitted_scene(tree, rig, simulate=simulate), ()
    if rig.table.simulation is not None:
        from station.drawn_scene import drawn_scene

        return drawn_scene(rig.table, rig.table.simulation, rig.camera_model, simulate=simulate), ()
    return None, (
        "limits, speeds and times are checked; what the camera will see isn't foreseen: the rig has no [simulation] "
        "that draws it; name a fitted session of it with --tree",
    )


def save_picture(outlook: Outlook, stem: Path) -> tuple[Path, ...]:
    """Write the picture of a forecast to stem.png and stem.svg; returns the files, none where nothing is foreseen.

    Raises:
        StationError: if they can't be written.
    """
    if outlook.forecast is None:
        return ()
    from station.commands.foreseen_views import foreseen_views, moments
    from station.report import save_figure
    from station.report.plan_figure import plan_figure

    shown = moments(outlook.forecast)
    views = foreseen_views(outlook.forecast, outlook.dictionary, shown)
    figure = plan_figure(outlook.forecast, outlook.joints, dict(zip(shown, views, strict=True)))
    try:
        stem.parent.mkdir(parents=True, exist_ok=True)
        save_figure(figure, stem)
    except OSError as error:
        raise StationError(f"can't write '{stem}.png': {error.strerror}; name another folder with --out") from error
    return tuple(stem.with_name(f"{stem.name}.{kind}") for kind in ("png", "svg"))


def marker_rows(forecast: Forecast) -> list[list[str]]:
    """A table of the markers, its header first."""
    rows = [["id", "part", "seen %", "tilt deg", "most", "size px", "smear", "first not seen"]]
    for row, mount in enumerate(forecast.scene.mounts):
        about = _of_marker(forecast, row)
        rows.append(
            [
                str(mount.marker_id),
                mount.part,
                f"{100 * forecast.seen[:, row].mean():.0f}",
                *(_text(about[name], "{:.0f}") for name in ("tilt_median_deg", "tilt_most_deg")),
                _text(about["size_px"], "{:.0f}"),
                _text(about["smear_most_px"], "{:.1f}"),
                str(about["first_unseen"] or ""),
            ]
        )
    return rows


def joint_rows(outlook: Outlook) -> list[list[str]]:
    """A table of the joints, its header first."""
    rows = [["joint", "goes", "in frames", "of its way", "tilt", "over 60 deg"]]
    for joint, limits in zip(outlook.joints, outlook.plan.joints, strict=True):
        seen = bool(joint.seen.any())
        rows.append(
            [
                joint.name,
                " to ".join(limits.text(value).replace(".0 ", " ") for value in joint.whole) if joint.moves else "-",
                f"{100 * joint.share:.0f} %",
                f"{100 * joint.travel_share:.0f} %" if joint.moves else "-",
                f"{np.degrees(np.nanmedian(joint.tilt_rad)):.0f} deg" if seen else "-",
                f"{100 * joint.oblique_share:.0f} %" if seen else "-",
            ]
        )
    return rows


def outlook_document(outlook: Outlook) -> dict[str, object]:
    """What is foreseen, as JSON; None stands for what is not known."""
    forecast = outlook.forecast
    return {
        "warnings": list(outlook.warnings),
        "notes": [*outlook.plan.motion.notes, *outlook.notes],
        "forecast": None
        if forecast is None
        else {
            "frames": len(forecast.t_s),
            "exposure_s": forecast.scene.exposure_s,
            "markers": [
                {
                    "id": mount.marker_id,
                    "part": mount.part,
                    "body": mount.body,
                    **_of_marker(forecast, row),
                    "intervals": _intervals(forecast, row),
                }
                for row, mount in enumerate(forecast.scene.mounts)
            ],
            "joints": [_of_joint(joint) for joint in outlook.joints],
        },
    }


def _of_marker(forecast: Forecast, row: int) -> dict[str, float | str | None]:
    """Figures of one marker in the frames that show it, of smear also in those that are too smeared."""
    seen, sight = forecast.seen[:, row], forecast.sight
    shown = seen | (forecast.reason[:, row] == SMEARED)
    tilt_deg = np.degrees(sight.tilt_rad[seen, row])
    unseen = np.flatnonzero(~seen)
    return {
        "seen": float(seen.mean()),
        "tilt_median_deg": _or_none(np.median, tilt_deg),
        "tilt_most_deg": _or_none(np.max, tilt_deg),
        "size_px": _or_none(np.median, sight.size_px[seen, row]),
        "smear_most_px": _or_none(np.max, sight.smear_px[shown, row]),
        "speed_most_px_s": _or_none(np.max, sight.speed_px_s[shown, row]),
        "first_unseen": _when_and_why(forecast, row, int(unseen[0])) if len(unseen) else None,
    }


def _when_and_why(forecast: Forecast, row: int, frame: int) -> str:
    return f"{forecast.t_s[frame]:.1f} s: {forecast.why(frame, row)}"


def _of_joint(joint: JointOutlook) -> dict[str, object]:
    return {
        "name": joint.name,
        "moves": joint.moves,
        "parent": joint.parent,
        "child": joint.child,
        "unmarked": list(joint.unmarked),
        "frames_seen": joint.share,
        "travel_seen": joint.travel_share,
        "range": list(joint.whole),
        "range_seen": None if joint.visible is None else list(joint.visible),
        "tilt_median_deg": _or_none(np.median, np.degrees(joint.tilt_rad[joint.seen])),
        "oblique": joint.oblique_share,
    }


def _intervals(forecast: Forecast, row: int) -> list[dict[str, object]]:
    """Runs of frames that show a marker or don't for one and the same reason."""
    tilt_deg = np.degrees(forecast.sight.tilt_rad[:, row])
    half_s = 0.5 * forecast.plan.duration_s / len(forecast.t_s)
    kind = np.stack([forecast.reason[:, row], forecast.obstacle[:, row]])
    kind[1, kind[0] != HIDDEN] = 0
    starts = np.flatnonzero(np.any(np.diff(kind, axis=1, prepend=-2), axis=0))
    ends = np.append(starts[1:], len(forecast.t_s))
    return [
        {
            "from_s": round(float(forecast.t_s[start] - half_s), 6),
            "to_s": round(float(forecast.t_s[end - 1] + half_s), 6),
            "seen": bool(forecast.seen[start, row]),
            "why": None if forecast.seen[start, row] else forecast.why(int(start), row),
            "tilt_deg": [round(float(f(tilt_deg[start:end])), 2) for f in (np.min, np.max)],
        }
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True)
    ]


def _or_none(of: Callable[[FloatArray], Any], values: FloatArray) -> float | None:
    return float(of(values)) if len(values) else None


def _text(value: float | str | None, form: str) -> str:
    return "-" if value is None else form.format(value)
