"""What a camera's calibration leaves in its folder: camera.toml, calibration.json, the views, how they cover the image.

Everything can be computed again from the views and board.toml.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from calibration.boards import RULER_MM, CharucoBoard
from calibration.camera_calibration import CameraCalibration
from calibration.camera_fit import PARAMETERS, parameters_of
from calibration.pictures import cover_picture, encode_png
from calibration.view_quality import ViewQuality
from station.formats.board import format_board
from station.formats.camera import format_camera

CALIBRATION_SCHEMA = "calibration/1"
CAMERA_FILE, CALIBRATION_FILE, COVER_FILE = "camera.toml", "calibration.json", "coverage.png"
BOARD_FILE, VIEWS_FOLDER = "board.toml", "views"


def write_calibration(folder: Path, done: CameraCalibration, board: CharucoBoard, when: datetime) -> None:
    """Write all but the views, which are written as they are taken."""
    folder.mkdir(parents=True, exist_ok=True)
    camera = replace(done.camera, when=when.isoformat(timespec="seconds"))
    (folder / CAMERA_FILE).write_text(format_camera(camera), encoding="utf-8")
    document = calibration_document(done, board, when)
    (folder / CALIBRATION_FILE).write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    (folder / BOARD_FILE).write_text(format_board(board, measured=True), encoding="utf-8")
    title = f"{len(done.shots)} views, {int(done.cover.sum())} corners; tinted: no corner of any view"
    picture = cover_picture([shot.view for shot in done.shots], done.cover, title)
    (folder / COVER_FILE).write_bytes(encode_png(picture))


def calibration_document(done: CameraCalibration, board: CharucoBoard, when: datetime) -> dict[str, Any]:
    """All numbers of a calibration, as calibration.json has them: strict JSON, null for what isn't known."""
    return {
        "schema": CALIBRATION_SCHEMA,
        "when": when.isoformat(timespec="seconds"),
        "board": {"spec": board.spec, "ruler_mm": [round(RULER_MM * share, 6) for share in board.stretch]},
        **result_document(done),
        "covariance": done.fit.covariance.tolist(),
        "cover": done.cover.astype(int).tolist(),
        "map_std_px": [[_number(value) for value in row] for row in done.map_std_px],
        "views": _views(done),
    }


def result_document(done: CameraCalibration) -> dict[str, Any]:
    """The result in short: verdict, parameters, errors."""
    fit, held_out, shift = done.fit, done.held_out, done.edge_shift
    values = parameters_of(fit.camera)
    return {
        "verdict": {
            "grade": done.verdict.grade.word,
            "remarks": [{"grade": each.grade.word, "what": each.what, "do": each.do} for each in done.verdict.remarks],
        },
        "size_px": list(fit.camera.size_px),
        "parameters": {
            name: {"value": float(value), "std": float(std)}
            for name, value, std in zip(PARAMETERS, values, fit.std, strict=True)
        },
        "rms_px": fit.camera.rms_px,
        "held_out_rms_px": None if held_out is None else held_out.rms_px,
        "held_out_focal_px": None if held_out is None else held_out.focal_px.tolist(),
        "edge_shift": None
        if shift is None
        else {"px": shift.shift_px, "std_px": shift.std_px, "markers": shift.markers},
        "marker_share": done.marker_share,
        "corners": {"used": int(fit.used.sum()), "dropped": int((~fit.used).sum())},
        "views_used": len(done.shots),
        "left_out": list(done.left_out),
    }


def _views(done: CameraCalibration) -> list[dict[str, Any]]:
    fit = done.fit
    view = np.repeat(np.arange(len(done.shots)), [len(shot.view) for shot in done.shots])
    rows: list[dict[str, Any]] = []
    for number, shot in enumerate(done.shots):
        used = (view == number) & fit.used
        squares = np.sum(fit.residual_px[used] ** 2, axis=1)
        rows.append({
            "name": shot.name,
            "corners": len(shot.view),
            "used": int(used.sum()),
            "rms_px": _number(np.sqrt(squares.mean())) if len(squares) else None,
            "held_out_rms_px": None if done.held_out is None else _number(done.held_out.by_view_px[number]),
            "sigma_px": float(fit.sigma_px[number]),
            **_quality(shot.quality),
        })  # fmt: skip
    return rows


def _quality(quality: ViewQuality) -> dict[str, Any]:
    return {
        "blur_px": _number(quality.blur_px),
        "tilt_deg": float(np.degrees(quality.tilt_rad)),
        "span": quality.span,
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def clear_calibration(folder: Path, *, keep: Sequence[Path] = ()) -> None:
    """Remove an earlier calibration's files, so that nothing of it passes for the next one's; not those to `keep`."""
    for name in (CAMERA_FILE, CALIBRATION_FILE, COVER_FILE):
        (folder / name).unlink(missing_ok=True)
    for path in (folder / VIEWS_FOLDER).glob("*.png"):
        if path not in keep:
            path.unlink()
