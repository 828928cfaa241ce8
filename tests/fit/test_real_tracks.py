"""Real doors and drawers tracked by others: each is called by its type, with nothing set for it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from station.fit.learner import learn
from station.formats.tracks import parse_track

TYPES = {
    "cabinet_one_door": "revolute",
    "kitchen_door_6d": "revolute",
    "kitchen_drawer_6d": "prismatic",
    "second_set_drawer": "prismatic",
}
SIBLING = Path(__file__).parents[3] / "shared" / "data" / "tracks"
FOLDER = Path(os.environ.get("STATION_TRACKS", SIBLING))

pytestmark = [
    pytest.mark.real_tracks,
    pytest.mark.skipif(not FOLDER.is_dir(), reason="no folder of real tracks; set STATION_TRACKS"),
]


@pytest.mark.parametrize("kind", TYPES)
def test_real_tracks_are_called_by_their_type(kind: str) -> None:
    files = sorted((FOLDER / kind).glob("*.log"))
    assert files
    found = {}
    for file in files:
        (joint,) = learn(parse_track(file.read_text(), file.name)).tree.joints
        found[file.name] = joint.type
    assert found == dict.fromkeys(found, TYPES[kind])
