"""What a section of the page is made of: plain values that the template draws, one macro a kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Text:
    """A paragraph; soft ones explain."""

    text: str
    soft: bool = False
    kind: str = field(default="text", init=False)


@dataclass(frozen=True)
class Bullets:
    """Sentences that want to be read: warnings."""

    items: Sequence[str]
    kind: str = field(default="bullets", init=False)


@dataclass(frozen=True)
class Tiles:
    """A few numbers at a glance: (what, number, what it means) each."""

    items: Sequence[tuple[str, str, str]]
    kind: str = field(default="tiles", init=False)


@dataclass(frozen=True)
class Table:
    """Rows of text under a head; the first column names the row.

    Attributes:
        label: what it is, for those who hear the page.
        texts: numbers of the columns that are words, set left; the others are numbers, set right.
        groups: heads above the head, each with the number of columns that it spans, from the left; "" for none.
    """

    label: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: frozenset[int] = frozenset()
    groups: Sequence[tuple[str, int]] = ()
    kind: str = field(default="table", init=False)

    @property
    def starts(self) -> frozenset[int]:
        """Columns at which a group with a head begins."""
        at, starts = 0, set[int]()
        for head, span in self.groups:
            if head:
                starts.add(at)
            at += span
        return frozenset(starts)


@dataclass(frozen=True)
class Drawing:
    """A figure.

    Attributes:
        name: unique on the page; ids within the drawing begin with it.
        svg: the drawing as `station.report.drawings.svg` makes it.
        alt: what it shows, for those who can't see it.
        wide: drawn no narrower than 50 rem: a small screen scrolls it.
    """

    name: str
    svg: bytes
    alt: str
    wide: bool = True
    kind: str = field(default="drawing", init=False)


@dataclass(frozen=True)
class Facts:
    """Names and values, two columns of them where there is room."""

    items: Mapping[str, str]
    kind: str = field(default="facts", init=False)


@dataclass(frozen=True)
class Source:
    """Text as it stands in a file, or as it is typed."""

    text: str
    kind: str = field(default="source", init=False)


@dataclass(frozen=True)
class Folded:
    """Blocks behind a line that unfolds them."""

    summary: str
    blocks: Sequence[Block]
    kind: str = field(default="folded", init=False)


Block = Text | Bullets | Tiles | Table | Drawing | Facts | Source | Folded


@dataclass(frozen=True)
class Section:
    """A part of the page, with its own entry in the list at the top.

    Attributes:
        id: where links lead.
        short: its name in the list of sections.
        title: its heading.
    """

    id: str
    short: str
    title: str
    blocks: Sequence[Block]
