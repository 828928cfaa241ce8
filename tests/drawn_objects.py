"""Objects drawn by the builder's edits, as somebody would draw them."""

from __future__ import annotations

import numpy as np

from station.builder.draft import Draft, blank
from station.builder.edits import add_part, rename_joint, set_limits
from station.builder.marking import set_block
from station.builder.placing import set_axis, set_zero

UPRIGHT = (0.0, 0.0, 0.0)


def swivel_chair() -> Draft:
    """The chair of the paper's Figure 1: its column rises, its seat swivels, its back reclines; z up, in front -y."""
    draft = blank("chair")
    draft = set_block(draft, "base", (0.5, 0.5, 0.06), (0.0, 0.0, 0.03))
    draft = add_part(draft, "column", "base", "prismatic")
    draft = set_zero(draft, "column", (0.0, 0.0, 0.2), UPRIGHT)
    draft = set_axis(draft, "column_joint", (0, 0, 1))
    draft = set_limits(draft, "column_joint", 0.0, 0.12)
    draft = set_block(draft, "column", (0.06, 0.06, 0.3))
    draft = add_part(draft, "seat", "column", "revolute")
    draft = set_zero(draft, "seat", (0.0, 0.0, 0.2), UPRIGHT)
    draft = set_axis(draft, "seat_joint", (0, 0, 1))
    draft = set_limits(draft, "seat_joint", -np.radians(80), np.radians(80))
    draft = set_block(draft, "seat", (0.42, 0.42, 0.06))
    draft = add_part(draft, "back", "seat", "revolute")
    draft = set_zero(draft, "back", (0.0, 0.2, 0.3), UPRIGHT)
    draft = set_axis(draft, "back_joint", (1, 0, 0), (0.0, 0.2, 0.05))
    draft = set_limits(draft, "back_joint", -np.radians(30), np.radians(20))
    draft = set_block(draft, "back", (0.4, 0.05, 0.4))
    for part, name in (("column", "height"), ("seat", "swivel"), ("back", "recline")):
        draft = rename_joint(draft, f"{part}_joint", name)
    return draft


def drawer_cabinet() -> Draft:
    """A cabinet with two drawers, which come out to the front, and a door beside them."""
    draft = blank("cabinet", "frame")
    draft = set_block(draft, "frame", (0.6, 0.3, 0.5), (0.0, 0.2, 0.25))
    for part, height in (("upper", 0.37), ("lower", 0.13)):
        draft = add_part(draft, part, "frame", "prismatic")
        draft = set_zero(draft, part, (-0.15, 0.0, height), UPRIGHT)
        draft = set_axis(draft, f"{part}_joint", (0, -1, 0))
        draft = set_limits(draft, f"{part}_joint", 0.0, 0.2)
        draft = set_block(draft, part, (0.28, 0.04, 0.2), (0.0, 0.03, 0.0))
    draft = add_part(draft, "door", "frame", "revolute")
    draft = set_zero(draft, "door", (0.15, 0.0, 0.25), UPRIGHT)
    draft = set_axis(draft, "door_joint", (0, 0, 1), (0.3, 0.05, 0.0))
    draft = set_limits(draft, "door_joint", 0.0, np.radians(100))
    return set_block(draft, "door", (0.28, 0.03, 0.46), (0.0, 0.03, 0.0))
