"""The HTML report, one file for screen and print, and the files beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from station.comparison_files import comparison_csv, comparison_json, write_files
from station.report.blocks import Drawing, Section
from station.report.drawings import png, svg
from station.report.figure7 import figure7
from station.report.material import Material
from station.report.sections import SECTIONS
from station.report.sections.joints import FIGURE7
from station.report.style import DARK, LIGHT

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

TEMPLATE = "page.html.j2"
# Names up to this long stay whole on paper, too.
UNBROKEN_LETTERS = 14


def save_figure(figure: Figure, path: Path) -> None:
    """Write `path`.png and `path`.svg."""
    write_files(path.parent, {f"{path.name}.png": png(figure), f"{path.name}.svg": svg(figure)})


def write_report(folder: Path, material: Material) -> None:
    """Write report.html and, with a comparison, figure7.png, figure7.svg, comparison.csv and comparison.json.

    All of them are made before any is written, and each is renamed to its name when it is whole.

    Args:
        folder: made if it isn't there.
        material: what to tell.
    """
    sections = [section for make in SECTIONS if (section := make(material)) is not None]
    files: dict[str, bytes] = {}
    if material.comparison is not None:
        figure = figure7(material.comparison, material.viewing)
        drawn = (block for section in sections for block in section.blocks if isinstance(block, Drawing))
        files = {
            "figure7.png": png(figure),
            "figure7.svg": next((drawing.svg for drawing in drawn if drawing.name == FIGURE7), None) or svg(figure),
            "comparison.csv": comparison_csv(material.comparison).encode(),
            "comparison.json": comparison_json(material.comparison).encode(),
        }
    write_files(folder, files | {"report.html": page(material, sections).encode()})


def page(material: Material, sections: Sequence[Section]) -> str:
    """The page that these sections make."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("station.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {"inline": inline, "breakable": breakable}
    compared = ", against what was commanded and what the servos read back" if material.comparison is not None else ""
    text = environment.get_template(TEMPLATE).render(
        title=material.title,
        subtitle=f"What the camera detected{compared}.",
        sections=sections,
        light=asdict(LIGHT),
        dark=asdict(DARK),
    )
    return text.replace(
        "&#39;", "'"
    )  # our attributes stand in double quotes; whoever reads the source wants apostrophes


def breakable(text: str) -> Markup:
    """A name that may be broken at its underscores where it is long and paper is narrow."""
    from markupsafe import Markup, escape

    safe = escape(text)
    return safe if len(text) <= UNBROKEN_LETTERS else safe.replace("_", Markup("_<wbr>"))


def inline(drawing: Drawing) -> str:
    """A drawing as an element of a page: its ids made unique by its name, its colours the page's variables."""
    text = drawing.svg.decode()
    text = text[text.index("<svg") :]
    text = re.sub(r'( id="|href="#|url\(#)', rf"\g<1>{drawing.name}-", text)
    for role, colour in asdict(LIGHT).items():
        text = text.replace(colour, f"var(--{role})")
    return text
