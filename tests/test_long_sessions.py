"""Sessions with more frames than a fit has memory for."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.commands import exports, fitting
from tests.sessions import capture_short

FEW = 300


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return capture_short(tmp_path_factory.mktemp("long"))[0]


def test_of_a_long_session_frames_are_left_out_evenly_and_it_is_said(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = fitting.fit(session, tmp_path / "whole")
    monkeypatch.setitem(fitting.load_session.__kwdefaults__, "most_sightings", FEW)
    thin = fitting.fit(session, tmp_path / "thin")
    assert not whole.notices
    (notice,) = thin.notices
    assert notice.startswith(f"{len(thin.fit.states.t_s)} of {len(whole.fit.states.t_s)} frames are used, evenly")
    assert len(thin.fit.states.t_s) < len(whole.fit.states.t_s) / 2
    found, wanted = (sorted((joint.name, joint.type) for joint in fit.fit.tree.joints) for fit in (thin, whole))
    assert found == wanted


def test_an_export_leaves_nothing_out(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(fitting.load_session.__kwdefaults__, "most_sightings", FEW)
    exportable = exports.read_exportable(session)
    assert exportable.poses is not None and exportable.observations is not None
    assert len(exportable.poses.t_s) == len(exportable.observations.t_s)
