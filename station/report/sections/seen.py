"""When each tracked part was seen."""

from __future__ import annotations

import numpy as np

from station.report.blocks import Block, Drawing, Section, Text
from station.report.drawings import svg
from station.report.figure7 import OBLIQUE_DEG
from station.report.material import Material
from station.report.visibility import visibility_figure

GAPS = (
    "Gaps: the part's markers were hidden, blurred, cut by the border of the image, or seen too obliquely for a pose. "
    f"Yellow: at more than {OBLIQUE_DEG:.0f} deg from their normal, where the detection is less accurate."
)


def seen_section(material: Material) -> Section | None:
    """None where nothing is known of it, as for a log of poses' fit alone."""
    seen = material.visibility
    if seen is None:
        return None
    blocks: list[Block] = []
    if not np.any(seen.seen):
        blocks.append(
            Text("No part was seen in any frame: look whether the markers are those of the rig, sharp and lit.")
        )
    if seen.parts:
        alt = "For each part, when it was seen, and in how many frames"
        blocks += [Drawing("visibility", svg(visibility_figure(seen)), alt), Text(GAPS, soft=True)]
    return Section("seen", "Visibility", "When the parts were seen", blocks)
