"""What the documents show is read as shown, and every command that they name is there."""

import re
from pathlib import Path

from station import cli
from station.formats.camera import parse_camera
from station.formats.motion import parse_motion
from station.formats.rig import parse_rig

ROOT = Path(__file__).parent.parent


def test_the_examples_of_rig_motion_and_camera_are_read():
    rig, camera, motion = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "rig.md").read_text("utf-8"), re.DOTALL)
    table = parse_rig(rig, "rig.md")
    assert parse_camera(camera, "rig.md").size_px == tuple(table.camera.size_px)
    assert parse_motion(motion, "rig.md", table.limits()).steps[0].repeat == 2


def test_the_readme_names_the_commands_that_there_are():
    readme = (ROOT / "README.md").read_text("utf-8")
    named = set(re.findall(r"^\| `station (\w+)", readme, re.MULTILINE))
    assert named == {command.callback.__name__ for command in cli.app.registered_commands if command.callback}


def test_links_of_the_documents_lead_somewhere():
    for document in (ROOT / "README.md", ROOT / "docs" / "rig.md"):
        for link in re.findall(r"\]\(([^)#:]+)\)", document.read_text("utf-8")):
            assert (document.parent / link).exists(), f"{document.name}: {link}"
