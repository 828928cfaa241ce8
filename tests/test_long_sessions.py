"""Sessions with more frames than a fit has memory for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.commands import exports, fitting
from station.recording import Recording
from tests.sessions import copy_of_short

FEW = 300


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_of_short(tmp_path_factory.mktemp("long"))


def test_of_a_long_session_frames_are_left_out_evenly_and_it_is_said(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = fitting.fit(session, tmp_path / "whole")
    monkeypatch.setitem(fitting.load_session.__kwdefaults__, "most_markers", FEW)
    thin = fitting.fit(session, tmp_path / "thin")
    assert not whole.notices
    (notice,) = thin.notices
    assert notice.startswith("one frame in 4 is used")
    assert len(thin.fit.states.t_s) == pytest.approx(len(whole.fit.states.t_s) / 4, abs=1)
    found, wanted = (sorted((joint.name, joint.type) for joint in fit.fit.tree.joints) for fit in (thin, whole))
    assert found == wanted


def test_a_thinned_recording_has_all_that_was_seen_in_the_frames_that_it_has(session: Path) -> None:
    whole, thin = Recording.load(session), Recording.load(session, most_markers=FEW)
    kept = np.isin(whole.frame_index, thin.frame_index)
    assert FEW / 2 < len(thin.observations) <= FEW
    assert np.all(np.diff(thin.frame_index) == 4)
    np.testing.assert_array_equal(thin.frame_ns, whole.frame_ns[kept])
    np.testing.assert_array_equal(
        thin.observations.corners_px, whole.observations.corners_px[kept[whole.observations.frame]]
    )
    assert thin.counts == whole.counts and len(thin.measured.t_s) == len(whole.measured.t_s)


def test_an_export_leaves_nothing_out(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(fitting.load_session.__kwdefaults__, "most_markers", FEW)
    exportable = exports.read_exportable(session)
    assert exportable.poses is not None and exportable.observations is not None
    assert len(exportable.poses.t_s) == len(exportable.observations.t_s)
