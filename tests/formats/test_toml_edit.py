"""Numbers changed in a rig's text: everything else stays, and what can't be done safely is refused."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from station.errors import InvalidFile
from station.formats.toml_edit import rewrite, set_numbers
from station.rig_reading import packaged, packaged_names

TEXT = """# my arm
schema = "rig/1"
[[joint]]
name = "pan"   # at the base
[[joint.servo]]
id = 1
zero = 512     # measured in May
[[joint]]
name = "lift"
[[joint.servo]]
id = 2
model = "AX-18A"

# its twin
[[joint.servo]]
id = 3
zero=0
[camera]
fps = 30
"""


def test_numbers_change_where_they_are_and_comments_stay():
    values = {
        ("joint", 0, "servo", 0, "zero"): 498,
        ("joint", 1, "servo", 1, "zero"): 530,
        ("camera", "latency_s"): 0.0312,
    }
    edited = set_numbers(TEXT, values, "rig.toml")
    want = TEXT.replace("zero = 512 ", "zero = 498 ").replace("zero=0", "zero=530")
    assert edited == want.replace("fps = 30\n", "fps = 30\nlatency_s = 0.0312\n")


def test_a_new_key_comes_after_the_last_of_its_table_not_after_the_next_ones_comment():
    edited = set_numbers(TEXT, {("joint", 1, "servo", 0, "zero"): 7}, "rig.toml")
    assert 'model = "AX-18A"\nzero = 7\n\n# its twin\n' in edited


@pytest.mark.parametrize("name", packaged_names("rigs"))
def test_every_number_of_a_packaged_rig_can_be_set(name: str):
    text = packaged("rigs", name).read_text("utf-8")
    table = tomllib.loads(text)
    zeros = {
        ("joint", j, "servo", s, "zero"): 100 * j + s
        for j, joint in enumerate(table["joint"])
        for s in range(len(joint["servo"]))
    }
    edited = tomllib.loads(set_numbers(text, {**zeros, ("camera", "latency_s"): 0.25}, name))
    assert edited["camera"]["latency_s"] == 0.25
    assert [[s["zero"] for s in joint["servo"]] for joint in edited["joint"]] == [
        [100 * j + s for s in range(len(joint["servo"]))] for j, joint in enumerate(table["joint"])
    ]


@pytest.mark.parametrize(
    "text",
    [
        'joint = [ { name = "pan", servo = [ { id = 1, zero = 5 } ] } ]\n',
        "[[joint]]\nservo = [\n  { id = 1, zero = 5 },\n]\n",
        "[[joint]]\n[[joint.servo]]\nzero = 0x1F\n",
        '[[joint]]\nnote = """\n[[joint.servo]]\nzero = 3\n"""\n[[joint.servo]]\nzero = 4\n',
        "[[joint]]\n",
    ],
    ids=["inline", "inline array", "hexadecimal", "text that looks like a table", "no such table"],
)
def test_what_cannot_be_changed_safely_is_refused_and_nothing_is_written(tmp_path: Path, text: str):
    path = tmp_path / "rig.toml"
    path.write_text(text)
    with pytest.raises(InvalidFile, match="set the values by hand"):
        rewrite(path, {("joint", 0, "servo", 0, "zero"): 9})
    assert path.read_text() == text and list(tmp_path.iterdir()) == [path]


def test_the_old_file_is_kept_each_time_with_the_line_ends_that_it_had(tmp_path: Path):
    path = tmp_path / "rig.toml"
    path.write_bytes(b"[camera]\r\nfps = 30")
    first = rewrite(path, {("camera", "latency_s"): 0.5})
    assert path.read_bytes() == b"[camera]\r\nfps = 30\r\nlatency_s = 0.5\r\n"
    second = rewrite(path, {("camera", "latency_s"): 0.25})
    assert first.read_bytes() == b"[camera]\r\nfps = 30" and b"= 0.5\r\n" in second.read_bytes()
    assert (first.name, second.name) == ("rig.toml.old", "rig.toml.old2")
