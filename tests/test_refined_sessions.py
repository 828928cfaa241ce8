"""What a session's tree is refined on, and what is said of it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from station.commands import fitting
from station.commands.fitting import Session, load_session
from station.compare import compare
from station.errors import StationError
from station.fit.options import FitOptions
from station.fit_files import TREE_FILE, read_fit
from station.quadrilaterals import shift_edges
from tests.sessions import copy_of_short

SHIFT_PX = 0.08


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_of_short(tmp_path_factory.mktemp("refined"))


def rmse_rad(session: Path, fit: fitting.FitResult) -> float:
    """Largest error of a joint's detected angle against the servo's read-back."""
    loaded = load_session(session)
    found = compare(fit.fit.states, loaded.recording.commanded, loaded.recording.measured)
    return max(joint.against_measured.rmse for joint in found.joints)


def test_a_session_is_refined_on_its_corners_and_its_file_says_so(session: Path, tmp_path: Path) -> None:
    found = fitting.fit(session, tmp_path / "fit")
    method = json.loads((tmp_path / "fit" / TREE_FILE).read_text())["method"]
    assert found.fit.image is not None
    assert (method["refine"], method["root"]) == ("image", "static")
    shift = method["camera"]["edge_shift_px"]
    assert (shift["value"], shift["std"]) == pytest.approx(
        (found.fit.image.numbers.edge_shift_px, found.fit.image.numbers_std.edge_shift_px)
    )
    assert method["camera"]["focal"] == {"value": 1.0, "std": None}


def test_corners_tell_the_joints_at_least_as_well_as_poses(session: Path, tmp_path: Path) -> None:
    by_image = fitting.fit(session, tmp_path / "image")
    by_poses = fitting.fit(session, tmp_path / "pose", options=FitOptions(refine="pose"))
    assert by_poses.fit.image is None
    assert by_poses.fit.tree.method["refine"] == "pose"
    assert rmse_rad(session, by_image) < 1.1 * rmse_rad(session, by_poses)


def test_the_numbers_of_the_camera_that_are_asked_for_are_told(session: Path, tmp_path: Path) -> None:
    options = FitOptions(camera_numbers=("edge_shift_px", "focal"))
    image = fitting.fit(session, tmp_path / "fit", options=options).fit.image
    assert image is not None
    assert abs(image.numbers.focal - 1.0) < 5 * image.numbers_std.focal
    assert np.isnan(image.numbers_std.readout_s)


def test_a_fit_reads_back_with_what_the_corners_told(session: Path, tmp_path: Path) -> None:
    found = fitting.fit(session, tmp_path / "fit").fit
    again = read_fit(tmp_path / "fit")
    assert again.tree.method["camera"].keys() == {"edge_shift_px", "focal", "readout_s"}  # type: ignore[attr-defined]
    assert again.tree.mounts.keys() == found.tree.mounts.keys() != set()
    np.testing.assert_allclose(again.states.q, found.states.q, atol=1e-9)


def shifted(session: Session, outward_px: float) -> Session:
    """The session as a camera would have seen it that shows edges elsewhere."""
    seen = replace(session.seen, corners_px=shift_edges(session.seen.corners_px, outward_px))
    return replace(session, seen=seen).with_edge_shift(0.0)


def test_a_shift_of_edges_that_nobody_told_is_found_and_undone_in_the_poses(session: Path) -> None:
    loaded = load_session(session)
    plain = fitting.discover(loaded, FitOptions())
    found = fitting.discover(shifted(loaded, SHIFT_PX), FitOptions())
    assert not plain.notices
    assert found.fit.image is not None
    assert found.fit.image.numbers.edge_shift_px == pytest.approx(SHIFT_PX, abs=0.02)
    (notice,) = found.notices
    assert re.match(r"edges are seen 0.0[78]\d px outward; poses were made anew", notice)
    one, other = (np.nanmedian(of.poses.T_ref_part[:, :, 2, 3], axis=0) for of in (plain, found))
    np.testing.assert_allclose(one, other, atol=2e-4)


def test_smoothed_poses_are_what_a_session_is_refined_on(session: Path, tmp_path: Path) -> None:
    found = fitting.fit(session, tmp_path / "fit", smooth="lowpass:5")
    assert found.fit.tree.method["refine"] == "pose"
    with pytest.raises(StationError, match="leave out --smooth"):
        fitting.fit(session, tmp_path / "none", options=FitOptions(refine="image"), smooth="lowpass:5")


def test_the_papers_method_takes_the_poses_of_a_session(session: Path, tmp_path: Path) -> None:
    assert fitting.fit(session, tmp_path / "fit", options=FitOptions(method="paper")).fit.image is None
