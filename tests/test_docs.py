"""What the documents show is read, and printed, as shown; every command, option and name of theirs is there."""

import ast
import inspect
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import station
from drivers.emulator import parse_fault
from drivers.emulator.faults import KINDS, REPLY_KINDS
from station import cli
from station.formats.camera import parse_camera
from station.formats.motion import MotionModel, StepModel, parse_motion
from station.formats.motion_kinds import CombinedModel, ExploreModel, ReplayModel, SinusoidsModel, WaveModel
from station.formats.rig import parse_rig
from station.logs import JointLog
from station.motion import JointLimits, plan_motion

ROOT = Path(__file__).parent.parent
DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
# A block of Python, and what it prints if that is shown right below it.
PYTHON = re.compile(r"```python\n(.*?)```(?:\n```text\n(.*?)```)?", re.DOTALL)
API = (ROOT / "docs" / "python.md").read_text("utf-8")


def test_the_examples_of_rig_motion_and_camera_are_read():
    rig, camera, motion = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "rig.md").read_text("utf-8"), re.DOTALL)
    table = parse_rig(rig, "rig.md")
    assert parse_camera(camera, "rig.md").size_px == tuple(table.camera.size_px)
    assert parse_motion(motion, "rig.md", table.limits()).steps[0].repeat == 2


def test_the_example_of_motions_is_read_and_has_every_key():
    (text,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "motions.md").read_text("utf-8"), re.DOTALL)
    joints = [JointLimits(name, -1.0, 1.0, 1.0) for name in ("shoulder", "elbow")]
    joints.append(JointLimits("lift", 0.0, 0.3, 0.1, park=0.1, unit="m"))
    t_s = np.arange(50) * 0.1
    by_hand = JointLog(t_s, ("elbow",), 0.1 * np.cos(t_s)[:, None], ("rad",))
    motion = parse_motion(text, "motions.md", joints, lambda file: {"by_hand": by_hand}[file])
    assert plan_motion(motion, joints).duration_s > 100
    models = (StepModel, MotionModel, CombinedModel, ExploreModel, SinusoidsModel, WaveModel, ReplayModel)
    keys = {key for model in models for key in model.model_fields}
    assert keys <= set(re.findall(r"[a-z_]+", text))


def test_the_readme_names_the_commands_that_there_are():
    readme = (ROOT / "README.md").read_text("utf-8")
    named = set(re.findall(r"^\| `station (\w+)", readme, re.MULTILINE))
    groups = {group.typer_instance.info.name for group in cli.app.registered_groups if group.typer_instance}
    commands = {command.callback.__name__ for command in cli.app.registered_commands if command.callback}
    assert named == commands | groups


def test_links_of_the_documents_lead_somewhere():
    for document in DOCUMENTS:
        for link in re.findall(r"\]\(([^)#:]+)\)", document.read_text("utf-8")):
            assert (document.parent / link).exists(), f"{document.name}: {link}"


@pytest.mark.parametrize(
    "document",
    [path for path in DOCUMENTS if "```python" in path.read_text("utf-8")],
    ids=lambda path: path.name,
)
def test_the_python_of_a_document_runs_from_top_to_bottom_and_prints_what_is_shown(
    document: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for number, (code, shown) in enumerate(PYTHON.findall(document.read_text("utf-8")), start=1):
        exec(compile(code, f"{document.name}, block {number}", "exec"), names)
        printed = capsys.readouterr().out
        assert printed == shown or not shown, f"{document.name}, block {number}"


def test_the_python_page_names_everything_that_there_is():
    named = set(re.findall(r"station\.(\w+)", API)) - {"commands"}
    values = {"Comparison", "Fit", "Joint"}  # what the calls return; nobody makes them
    assert named | values == set(station.__all__)


def test_the_options_of_the_python_page_are_those_of_the_fit():
    rows = re.findall(r"^\| `(\w+)` \| `(.*?)` \| .* \|$", API[API.index("## Options") :], re.MULTILINE)
    parameters = list(inspect.signature(station.fit).parameters.values())[1:]
    assert {name: ast.literal_eval(default) for name, default in rows} == {p.name: p.default for p in parameters}


@pytest.mark.parametrize("keyword", ["method", "criterion", "joint_types"])
def test_the_choices_of_the_python_page_are_those_of_the_fit(keyword: str):
    row = next(line for line in API.splitlines() if line.startswith(f"| `{keyword}` |"))
    shown = re.findall(r'`"(\w[\w-]*)"`', row.split("|")[3])
    still = station.PoseLog(np.arange(12.0), "camera", ("door",), np.tile(np.eye(4), (12, 1, 1, 1)))
    with pytest.raises(station.StationError) as refused:
        station.fit(still, **{keyword: ("nonsense",) if keyword == "joint_types" else "nonsense"})
    assert sorted(shown) == sorted(str(refused.value).split(" of ")[-1].split(", "))


SDK_TRIES = 5  # it waits 34 ms for a reply: on a machine with other work to do, that can be too short
EMULATOR = (ROOT / "docs" / "emulator.md").read_text("utf-8")


def test_the_fixture_of_the_emulators_page_runs_under_pytest(tmp_path: Path):
    (code,) = re.findall(r"```python\n(.*?)```", EMULATOR, re.DOTALL)
    (tmp_path / "test_mine.py").write_text(code, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "error", "test_mine.py"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for _ in range(SDK_TRIES):
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            break
    assert done.returncode == 0 and "1 passed" in done.stdout, done.stdout + done.stderr


def test_the_shell_of_the_emulators_page_works(tmp_path: Path):
    start, ask = re.findall(r"```sh\n(.*?)```", EMULATOR, re.DOTALL)
    link = tmp_path / "ttyARM"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    started = shlex.split(start.replace("/tmp/ttyARM", str(link)))
    assert started[0] == "station"
    command = [sys.executable, "-c", "from station.cli import main; main()", *started[1:]]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=environment, stdout=pipe, stderr=pipe, text=True) as emulator:
        assert emulator.stdout is not None and emulator.stdout.readline().strip() == str(link)
        script = ask.replace("/tmp/ttyARM", str(link)).replace("python -c", f"{sys.executable} -c")
        for _ in range(SDK_TRIES):
            said = subprocess.run(
                script, shell=True, env=environment, capture_output=True, text=True, check=True
            ).stdout
            if said == "(1020, 0, 0)\n":
                break
        emulator.terminate()
        emulator.communicate(timeout=60)
    assert said == "(1020, 0, 0)\n"


def test_the_table_of_faults_is_that_of_the_code():
    rows = re.findall(r"^\| `(\w+)` \| (.*?) ?\| (.*?) \|$", EMULATOR, re.MULTILINE)
    shown = {kind: (value, text) for kind, value, text in rows if kind in KINDS}
    assert shown == {kind: (about.value, about.text) for kind, about in KINDS.items()}
    assert list(shown) == list(KINDS) and list(KINDS)[:10] == list(REPLY_KINDS)
    for spec in re.findall(r'`([a-z_]+:[\d,]+@[^`\s]*)`|"([a-z_]+:\d+@[^"\s]*)"', EMULATOR):
        parse_fault("".join(spec))
