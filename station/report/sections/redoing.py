"""What it takes to do the session again: command lines, settings, options of the fit, versions."""

from __future__ import annotations

from collections.abc import Mapping

from station.report.blocks import Block, Facts, Folded, Section, Source, Text
from station.report.material import Material


def redoing_section(material: Material) -> Section | None:
    """None where nothing of it is known."""
    redoing = material.redoing
    blocks: list[Block] = []
    if redoing.lines:
        blocks += [Text("In the session's folder:"), Source("\n".join(redoing.lines))]
    if redoing.method:
        blocks += [Text("How it was fitted:"), Facts(_plain(redoing.method))]
    if redoing.versions:
        blocks += [Text("With these programs:"), Facts(redoing.versions)]
    if redoing.files:
        blocks.append(Text("With these settings:"))
        blocks += [Folded(name, [Source(text.strip())]) for name, text in redoing.files.items()]
    return Section("redoing", "Settings", "To do it again", blocks) if blocks else None


def _plain(method: Mapping[str, object]) -> dict[str, str]:
    """Lists and tables of JSON as words."""
    return {name.replace("_", " "): _words(value) for name, value in method.items()}


def _words(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_words(each)}" for name, each in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_words(each) for each in value)
    return {None: "-", True: "yes", False: "no"}.get(value, f"{value:.6g}" if isinstance(value, float) else str(value))  # type: ignore[arg-type]
