"""A session's recording in rerun files: the only modules, with station/view.py, that import rerun (0.6 s)."""

from station.recording.contents import Event, ServoLog
from station.recording.detected import append_detected
from station.recording.lock import SessionBusy
from station.recording.reader import Recording
from station.recording.writer import RecordingWriter

__all__ = ["Event", "Recording", "RecordingWriter", "ServoLog", "SessionBusy", "append_detected"]
