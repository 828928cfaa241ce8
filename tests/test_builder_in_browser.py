"""The tree builder in a real browser, by clicks and typing alone. Skipped where there is no Chromium."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.builder.documents import to_text
from station.builder.page.builder import Builder
from station.builder.page.gizmo import SIZE_RADII
from station.builder.placing import part_gizmo
from station.builder.stored import load_draft, save_draft
from station.commands import building
from tests.browsers import SOFTWARE_3D, chromium
from tests.builder_tab import Tab

pytest.importorskip("viser", reason="the extra 'gui' is not installed")
# Of a machine that draws with its processor and has other work: alone it takes a tenth of this.
pytestmark = pytest.mark.timeout(600)

# Part, its joint, type, limits, axis, its point [mm], the part's place [mm]: the upper half of a swivel chair.
CHAIR = (
    ("backrest", "recline", "revolute", (-30, 10), (0, 1, 0), (-220, 0, 50), (-260, 0, 350)),
    ("column", "height", "prismatic", (0, 120), (0, 0, -1), None, (0, 0, -150)),
    ("base", "swivel", "revolute", (-180, 180), (0, 0, 1), (0, 0, -100), (100, 0, -200)),
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium(*SOFTWARE_3D) as browser:
        yield browser


@pytest.fixture
def builder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Builder]:
    monkeypatch.chdir(tmp_path)
    with building.build() as builder:
        yield builder


def test_a_swivel_chair_is_built_by_clicks_tried_saved_and_read_again(browser: Any, builder: Builder, tmp_path: Path):
    with Tab(browser, builder.address) as tab:
        tab.type("Name", "seat")
        tab.click("Apply")
        tab.sees("seat · root")
        for part, joint, kind, limits, axis, point, place in CHAIR:
            tab.choose("Part", "column" if part == "base" else "seat")
            tab.click("Add")
            tab.shows("Name", "part")
            tab.choose("Joint type", kind)
            unit = "mm" if kind == "prismatic" else "deg"
            tab.type("Name", part)
            tab.type("Joint name", joint)
            tab.type(f"Lower [{unit}]", limits[0])
            tab.type(f"Upper [{unit}]", limits[1])
            tab.type("Axis", *axis)
            if point is not None:
                tab.type("Axis at [mm]", *point)
            tab.type("Place [mm]", *place)
            tab.presses_enter("Name")
            tab.sees(f"{part} · {joint}, {kind}")
        assert_is_the_chair(builder)

        tab.opens("Try")
        tab.click("Simulate and fit")
        tab.sees("Found: all bodies, 3 joints between the right ones, all of the right type")

        tab.opens("Files")
        tab.type("File", "chair.json")
        tab.click("Save")
        tab.sees("chair.json · saved")
        assert to_text(load_draft(tmp_path / "chair.json")) == to_text(builder.draft)
        saved = to_text(builder.draft)
        tab.choose("Example", "lamp")
        tab.click("Open example")
        tab.sees("foot · root", "lamp.json")
        tab.type("File", "chair.json")
        tab.click("Open")
        tab.sees("chair.json · saved")
        assert to_text(builder.draft) == saved
        assert_is_the_chair(builder)
        here = builder.address.removeprefix("http://")
        assert [
            url for url in tab.asked if not url.startswith((f"http://{here}/", f"ws://{here}", "data:", "blob:"))
        ] == []
        assert tab.said == []


def assert_is_the_chair(builder: Builder) -> None:
    tree = builder.draft.tree
    assert tree.root == "seat" and set(tree.parts) == {"seat", *(row[0] for row in CHAIR)}
    for part, name, kind, limits, axis, point, place in CHAIR:
        joint = tree.joint(name)
        per_unit = 1e-3 if kind == "prismatic" else np.radians(1.0)
        assert (joint.child, joint.type) == (part, kind)
        assert joint.parent == ("column" if part == "base" else "seat")
        np.testing.assert_allclose(joint.limits, np.multiply(limits, per_unit), rtol=1e-9)
        np.testing.assert_allclose(joint.axis_parent, axis, atol=1e-9)
        np.testing.assert_allclose(joint.T_parent_child_zero[:3, 3], np.multiply(place, 1e-3), atol=1e-9)
        if point is not None:
            np.testing.assert_allclose(joint.point_parent_m, np.multiply(point, 1e-3), atol=1e-9)


def test_what_is_refused_is_told_and_changes_nothing_and_all_else_can_be_undone(browser: Any, builder: Builder):
    with Tab(browser, builder.address) as tab, Tab(browser, builder.address) as other:
        empty = to_text(builder.draft)
        tab.click("Add")
        tab.sees("part · part_joint, revolute")
        other.sees("part · part_joint, revolute", "unsaved changes")
        added = to_text(builder.draft)

        tab.type("Axis", 0, 0, 0)
        tab.click("Apply")
        tab.sees("the axis is zero and points nowhere")
        assert to_text(builder.draft) == added
        assert not other.page.get_by_text("points nowhere").count(), "what one is told, the others needn't read"
        tab.shows("Axis", 0, 0, 0)  # to be mended, not to be typed again
        tab.type("Axis", 0, 2, 0)
        tab.click("Apply")
        tab.shows("Axis", 0, 1, 0)
        turned = to_text(builder.draft)

        other.click("Undo")
        tab.shows("Axis", 0, 0, 1)
        assert to_text(builder.draft) == added
        tab.click("Undo")
        tab.sees("in no file yet")
        assert to_text(builder.draft) == empty
        for _ in range(2):
            other.click("Redo")
        tab.until(lambda: to_text(builder.draft) == turned, "both steps are there again")
        assert builder.left() is not None


def test_a_part_is_dragged_with_the_mouse_in_one_step(browser: Any, builder: Builder, tmp_path: Path):
    save_draft(load_draft("lamp"), tmp_path / "lamp.json")
    with Tab(browser, builder.address) as tab:
        tab.opens("Files")
        tab.type("File", "lamp.json")
        tab.click("Open")
        tab.sees("lamp.json · saved")
        before = builder.draft
        tab.opens("Build")
        tab.choose("Part", "upper_arm")
        tab.choose("Drag", "part")
        dragged_m = SIZE_RADII * builder.page.scene.radius_m
        place_m = np.array(part_gizmo(before, "upper_arm", before.usual_states())[1])
        for _ in range(5):  # until the gizmo is drawn a drag turns the camera
            start, end = (place_m + share * dragged_m * np.array([0.0, 0.0, 1.0]) for share in (0.7, 1.7))
            camera = builder.page.server.initial_camera
            tab.drags(tab.pixel(camera, start), tab.pixel(camera, end))
            if builder.draft is not before:
                break
            tab.click("Look at all")
        tab.sees("Last: drag upper_arm.")
        moved_m = np.array(part_gizmo(builder.draft, "upper_arm", before.usual_states())[1]) - place_m
        np.testing.assert_allclose(moved_m[:2], 0.0, atol=1e-9)
        assert moved_m[2] == pytest.approx(dragged_m, rel=0.1)
        tab.click("Undo")
        tab.sees("lamp.json · saved")
        assert to_text(builder.draft) == to_text(before)


def test_it_is_played_downloaded_and_uploaded_and_a_long_fit_is_cancelled(browser: Any, builder: Builder):
    with Tab(browser, builder.address) as tab:
        tab.click("Add")
        tab.sees("part · part_joint, revolute")
        tab.page.get_by_text("Markers", exact=True).first.click()
        tab.click("Mark all parts")
        tab.sees("places are sought in which a camera sees the markers")
        tab.sees("Last: mark all parts.")
        drawn = to_text(builder.draft)
        tab.opens("Try")
        tab.click("Play")
        tab.page.get_by_text(re.compile(r"Frame \d{2,}, seed 0")).wait_for()
        tab.click("Pause")
        tab.click("Stop")
        tab.sees("Not playing.")

        tab.opens("Files")
        with tab.page.expect_download() as download:
            tab.click("kinematics.json")
        assert Path(download.value.path()).read_text("utf-8") == drawn
        upload = {"name": "mine.json", "mimeType": "application/json", "buffer": drawn.encode()}
        tab.page.locator("input[type=file]").set_input_files(upload)
        tab.sees("draft.json has unsaved changes, which opening another loses.")
        tab.click("Open all the same")
        tab.sees("mine.json · in no file yet")
        assert to_text(builder.draft) == drawn
        tab.page.locator("input[type=file]").set_input_files(upload | {"buffer": b"{"})
        tab.sees("mine.json is no JSON")
        assert to_text(builder.draft) == drawn

        tab.opens("Try")
        tab.type("Frames", 2000)
        tab.type("Inflation", 4)
        tab.click("Simulate and fit")
        tab.page.get_by_role("button", name="Simulate and fit", disabled=True).wait_for()
        tab.click("Cancel the fit")
        tab.sees("the fit was ended before it was done")
        tab.page.get_by_role("button", name="Simulate and fit", disabled=False).wait_for()
        tab.click("Simulate and fit")
        tab.page.get_by_role("button", name="Simulate and fit", disabled=True).wait_for()
        tab.click("Play")  # the builder ends with both under way, and leaves nothing behind
