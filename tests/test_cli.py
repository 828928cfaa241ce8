"""The command line as people meet it: output, errors, exit codes."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from station.formats.poses_csv import format_poses_csv
from station.kinematics import se3
from station.logs import PoseLog
from station.recording import Recording
from station.rig_reading import packaged
from station.session import read_status
from tests.sessions import SHORT, copy_of_short, write_motion

# Bytes of a recording that holds frames for certain.
SOME_FRAMES = 300_000
COMMANDS = (
    "demo",
    "run",
    "capture",
    "fit",
    "compare",
    "report",
    "view",
    "plan",
    "scan",
    "doctor",
    "emulate",
    "track",
    "export",
)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_of_short(tmp_path_factory.mktemp("cli"))


@pytest.fixture
def session(short: Path, tmp_path: Path) -> Path:
    """A copy of the short session, to do as one likes."""
    return Path(shutil.copytree(short, tmp_path / "session"))


def write_door(folder: Path) -> Path:
    """A door that swings through 60 degrees in front of a camera, with a millimetre of noise."""
    rng = np.random.default_rng(0)
    swing = se3.rotation_z(np.linspace(0, np.pi / 3, 80))
    T = se3.translation([0.3, 0.1, 1.0]) @ swing @ se3.translation([0.4, 0.0, 0.0])
    T = T @ se3.exp(rng.normal(size=(80, 6)) * ([0.001] * 3 + [0.01] * 3))
    log = PoseLog(np.arange(80) / 30, "world", ("door",), T[:, None])
    path = folder / "door.csv"
    path.write_text(format_poses_csv(log), encoding="utf-8")
    return path


def test_each_command_has_help(station):
    code, out, _ = station("--help")
    assert code == 0
    for command in COMMANDS:
        assert command in out
        code, text, _ = station(command, "--help")
        assert code == 0 and "Usage: station" in text


def test_the_version_is_told_without_a_command(station):
    code, out, _ = station("--version")
    assert code == 0 and re.fullmatch(r"station \d+\.\d+\.\d+\n", out)


def test_help_loads_none_of_the_heavy_libraries():
    code = (
        "import sys; sys.argv = ['station', '--help']\n"
        "from station import cli\n"
        "try:\n    cli.main()\nexcept SystemExit:\n    pass\n"
        "heavy = {'rerun', 'cv2', 'matplotlib', 'scipy', 'numpy', 'pydantic'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_wrong_usage_is_exit_code_2(station):
    assert station("fly")[0] == 2
    assert station("run", "demo")[0] == 2
    assert station("fit", "x", "--criterion", "--json")[0] in (1, 2)


def test_plan_shows_what_would_be_commanded_and_moves_nothing(station, tmp_path: Path):
    code, out, _ = station("plan", "demo", "demo")
    assert code == 0 and "within all limits" in out and "base_pan to 80 deg" in out
    code, out, _ = station("plan", "demo", write_motion(tmp_path), "--json")
    document = json.loads(out)
    assert code == 0 and document["legs"][0]["to"]["base_pan"] == pytest.approx(np.radians(30))


def test_run_ends_with_the_table_and_where_to_look(station, tmp_path: Path):
    out_dir = tmp_path / "run"
    code, out, err = station("run", "demo", write_motion(tmp_path), "--out", out_dir)
    assert code == 0, err
    for joint in ("base_pan", "shoulder", "elbow", "wrist"):
        assert joint in out
    assert max(map(len, out.splitlines())) <= 100
    for name in ("figure7.png", "figure7.svg", "report.html", "comparison.csv", "comparison.json"):
        assert (out_dir / "report" / name).stat().st_size > 0
    for name in ("kinematics.json", "joint_states.csv", "kinematics.urdf", "tree.png", "fit.rrd"):
        assert (out_dir / "fit" / name).stat().st_size > 0
    comparison = json.loads((out_dir / "report" / "comparison.json").read_text(encoding="utf-8"))
    assert comparison["schema"] == "comparison/1"
    assert {joint["joint"]: joint["type"] for joint in comparison["joints"]} == dict.fromkeys(
        ("base_pan", "shoulder", "elbow", "wrist"), "revolute"
    )
    assert all(joint["measured"]["rmse_deg"] < 1.0 for joint in comparison["joints"])
    tree = json.loads((out_dir / "fit" / "kinematics.json").read_text(encoding="utf-8"))
    assert {joint["name"] for joint in tree["joints"]} == {"base_pan", "shoulder", "elbow", "wrist"}
    assert "figure7.png" in err and "station view" in err
    assert "station fit" not in err  # it is fitted


def test_fit_reads_the_recording_alone(station, session: Path, tmp_path: Path):
    for path in session.iterdir():
        if path.name != "recording.rrd":
            path.unlink()
    code, out, err = station("fit", session / "recording.rrd", "--out", tmp_path / "fit", "--json")
    assert code == 0, err
    assert {joint["name"] for joint in json.loads(out)["joints"]} >= {"base_pan", "elbow"}


def test_fit_then_compare_then_report(station, session: Path):
    assert station("fit", session)[0] == 0
    code, out, _ = station("compare", session, "--json")
    assert code == 0 and len(json.loads(out)["joints"]) == 4
    assert station("report", session)[0] == 0
    code, _, err = station("fit", session)
    assert code == 1 and "isn't empty" in err
    assert station("fit", session, "--force")[0] == 0


def test_compare_takes_commands_of_another_clock(station, session: Path, tmp_path: Path):
    assert station("fit", session)[0] == 0
    recording = Recording.load(session)
    rows = ["t_s,base_pan,elbow"]
    for t, q in zip(recording.measured.t_s, recording.measured.q, strict=True):
        rows.append(f"{t + 100.0:.9f},{q[0]:.9f},{q[2]:.9f}")
    path = tmp_path / "commands.csv"
    path.write_text("\n".join(rows), encoding="utf-8")
    code, out, err = station("compare", session, "--commands", path, "--json")
    assert code == 0, err
    joints = {joint["joint"]: joint for joint in json.loads(out)["joints"]}
    assert set(joints) == {"base_pan", "elbow"}
    assert joints["base_pan"]["commanded"]["lag_s"] == pytest.approx(-100.0, abs=0.05)
    # Rows of read-back held as commands: half a row of 20 ms late at up to 50 deg/s.
    assert joints["base_pan"]["commanded"]["rmse_deg"] < 1.0


def test_a_log_of_poses_is_fitted_and_drawn(station, tmp_path: Path):
    code, out, err = station("fit", write_door(tmp_path), "--out", tmp_path / "out")
    assert code == 0, err
    tree = json.loads((tmp_path / "out" / "kinematics.json").read_text(encoding="utf-8"))
    assert [(joint["type"], joint["parent"], joint["child"]) for joint in tree["joints"]] == [
        ("revolute", "world", "door")
    ]
    assert "revolute" in out and (tmp_path / "out" / "tree.svg").exists()


def errors_are_short(err: str) -> bool:
    return err.startswith("error: ") and len(err.splitlines()) <= 5 and "Traceback" not in err


def test_bad_input_is_one_clear_error_and_leaves_nothing(station, session: Path, tmp_path: Path):
    out = tmp_path / "out"
    demo = packaged("rigs", "demo").read_text(encoding="utf-8")
    (tmp_path / "key.toml").write_text(demo.replace("baud =", "baut ="), encoding="utf-8")
    (tmp_path / "type.toml").write_text(demo.replace("fps = 30", 'fps = "30"'), encoding="utf-8")
    head, tail = demo.split("[camera.calibration]")
    (tmp_path / "blind.toml").write_text(head + tail[tail.index("# 2-inch") :], encoding="utf-8")
    no_port = demo.replace('"emulated"', '"/dev/ttyNOWHERE"').replace('"rendered"', "97")
    (tmp_path / "port.toml").write_text(no_port, encoding="utf-8")
    (tmp_path / "camera.toml").write_text(demo.replace('"rendered"', "97"), encoding="utf-8")
    far = write_motion(tmp_path, SHORT.replace("base_pan = 30", "base_pan = 300"))
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(SHORT.replace("hold_s", "hold"), encoding="utf-8")
    code, _, err = station("report", session)
    assert code == 1 and err.endswith(f"run: station fit {session}\n")
    torn = session / "recording.rrd"
    torn.write_bytes(torn.read_bytes()[:64])
    lost = tmp_path / "lost.toml"
    replays = 'schema = "motion/1"\nname = "lost"\nmode = "stream"\n[[step]]\nreplay = { file = "nowhere" }\n'
    lost.write_text(replays, encoding="utf-8")
    cases = [
        (("plan", "demo", lost), "nowhere is missing; what is replayed is a session's folder or a commands.csv"),
        (("capture", "demo", far, "--out", out), "base_pan would go to 300.0 deg"),
        (("capture", "demo", wrong, "--out", out), "step 1, hold: unknown key"),
        (("capture", "demo", tmp_path / "gone.toml", "--out", out), "gone.toml"),
        (("capture", "no_such_rig", "demo", "--out", out), "packaged ones are crustcrawler_ax18a, demo"),
        (("capture", tmp_path / "key.toml", "demo", "--out", out), "bus, baut: unknown key"),
        (("capture", tmp_path / "type.toml", "demo", "--out", out), "camera, fps"),
        (("capture", tmp_path / "blind.toml", "demo", "--out", out), "no calibration"),
        (("capture", tmp_path / "port.toml", "demo", "--out", out), "/dev/ttyNOWHERE"),
        (("capture", tmp_path / "camera.toml", "demo", "--out", out), "97"),
        (("capture", "demo", "demo", "--out", session), "isn't empty"),
        (("fit", tmp_path / "gone", "--out", out), "no input"),
        (("fit", session, "--out", out), "recording.rrd"),
        (("compare", session), "recording.rrd"),
    ]
    for arguments, said in cases:
        code, _, err = station(*arguments)
        assert code == 1, (arguments, err)
        assert errors_are_short(err) and said in err, (arguments, err)
        assert not out.exists(), arguments


def test_a_recording_cut_short_is_fitted_with_a_notice(station, session: Path, tmp_path: Path):
    recording = session / "recording.rrd"
    recording.write_bytes(recording.read_bytes()[: int(recording.stat().st_size * 0.9)])
    code, _, err = station("fit", session)
    assert code == 0, err
    assert "warning:" in err and "recording.rrd" in err


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_capture_with_the_recording_whole(tmp_path: Path, sent: signal.Signals, code: int):
    out = tmp_path / "session"
    program = "import sys; from station.cli import main; sys.argv[0] = 'station'; main()"
    arguments = ["capture", "demo", "demo", "--out", str(out)]
    process = subprocess.Popen(
        [sys.executable, "-c", program, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    recording_file = out / "recording.rrd"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not (recording_file.exists() and recording_file.stat().st_size > SOME_FRAMES):
        time.sleep(0.05)
    os.kill(process.pid, sent)
    _, err = process.communicate(timeout=60)
    assert process.returncode == code, err
    assert "Traceback" not in err and f"what was recorded is in {out}" in err
    assert read_status(out).state == "interrupted"
    recording = Recording.load(out)
    assert not recording.notices and recording.frames > 0
    assert re.search("arm left: park-then-release", "\n".join(event.text for event in recording.events))
