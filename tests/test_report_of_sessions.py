"""Claims of reports of sessions: of an arm while the wall clock jumps, of one that saw nothing, of a fit alone."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from station.commands import capturing, fitting, reporting
from station.formats.joint_csv import format_joint_states
from station.recording import Recording, RecordingWriter, writer
from station.session import read_status
from tests.made_sessions import START_NS, describe, log_frame, make_frames
from tests.sessions import capture_short
from tests.test_report import arm, states_of


class JumpingClock(datetime):
    """A wall clock that goes back by an hour each time that somebody looks."""

    looks = 0

    @classmethod
    def now(cls, tz=None) -> datetime:
        cls.looks += 1
        return datetime(2024, 5, 6, 7, tzinfo=tz or UTC) - timedelta(hours=cls.looks)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Captured, fitted and reported while the wall clock jumps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(capturing, "datetime", JumpingClock)
        patch.setattr(writer, "datetime", JumpingClock)
        patch.setattr(time, "time", lambda: 1e9 + 3600 * np.random.default_rng().normal())
        folder, _ = capture_short(tmp_path_factory.mktemp("jumps"))
    fitting.fit(folder)
    reporting.report(folder)
    return folder


def test_a_wall_clock_that_jumps_leaves_stamps_lag_and_errors_as_they_are(session: Path) -> None:
    status, recording = read_status(session), Recording.load(session)
    assert JumpingClock.looks >= 2 and status.ended is not None and status.ended < status.started
    np.testing.assert_allclose(np.diff(recording.frame_ns), 1e9 / 30, atol=1)
    assert np.all(np.diff(recording.stamps_ns[:, 0]) > 0) and np.all(np.diff(recording.measured.t_s) < 0.03)
    comparison = reporting.compare(session)
    lag = comparison.lag
    # The rig's latency is the emulated camera's: what is left is within the time from request to reply, 4 ms.
    assert lag.std_s is not None and abs(lag.lag_s or 0.0) < 0.002 + 4 * lag.std_s
    assert all(j.against_measured is not None and np.degrees(j.against_measured.rmse) < 0.2 for j in comparison.joints)


def test_the_report_of_a_session_has_all_sections_and_how_to_do_it_again(session: Path) -> None:
    page = (session / "report" / "report.html").read_text("utf-8")
    sections = ("summary", "joints", "errors", "tree", "fit", "seen", "timing", "events", "redoing")
    assert [name for name in sections if f'<section id="{name}"' not in page] == []
    assert "station capture rig.toml motion.toml --out ../again --seed 0 --simulate" in page
    assert "station fit . --force" in page and ">rig.toml</summary>" in page and ">camera.toml</summary>" in page
    assert "with the read-back's rounding" in page and "latency taken off the frames' stamps</dt><dd>16.0 ms" in page
    assert ('<section id="servos"' in page) == bool(len(Recording.load(session).servos.t_s))


def test_a_session_in_which_no_marker_was_seen_has_a_report(station, tmp_path: Path) -> None:
    frames = [frame for frame in make_frames(40) if not len(frame.markers)]
    with RecordingWriter(tmp_path / "s", describe(rig=None, motion=None), start_ns=START_NS) as recording:
        for frame in frames:
            log_frame(recording, frame)
        recording.close("interrupted", {"dropped_frames": 3})
    code, _, err = station("report", tmp_path / "s")
    assert code == 0 and "nothing was fitted" in err
    page = (tmp_path / "s" / "report" / "report.html").read_text("utf-8")
    assert "no marker was seen in any frame" in page and "Nothing was fitted" in page
    assert "<dt>state</dt><dd>interrupted</dd>" in page and "<dt>dropped frames</dt><dd>3</dd>" in page


def test_the_folder_of_a_fit_has_a_report(station, tmp_path: Path) -> None:
    from station.fit.result import Fit
    from station.fit_files import write_fit

    write_fit(Fit(arm(), states_of(arm())), tmp_path / "fit")
    assert format_joint_states(states_of(arm())) == (tmp_path / "fit" / "joint_states.csv").read_text()
    code, out, err = station("report", tmp_path / "fit")
    assert code == 0, err
    assert "revolute" in out
    page = (tmp_path / "fit" / "report" / "report.html").read_text("utf-8")
    assert "<h1>fit</h1>" in page and page.count("<svg") == 2
    code, out, _ = station("report", tmp_path / "fit", "--json")
    assert code == 0 and json.loads(out)["joints"] == []
