"""Nodes of the scene that are kept while nothing about them changes: a page that moves sends poses, not boxes."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viser import SceneNodeHandle


@dataclass(frozen=True)
class Wanted:
    """A node that shall be there.

    Attributes:
        look: what it looks like; a node that looks otherwise than before is made anew.
        make: makes the node of that name.
    """

    look: Hashable
    make: Callable[[str], SceneNodeHandle]


class Nodes:
    """The nodes below one name of the scene."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[Hashable, SceneNodeHandle]] = {}

    def show(self, wanted: Mapping[str, Wanted]) -> None:
        """Have these nodes there, by name, and no others; parents come before their children."""
        for name in [name for name in reversed(self._kept) if name not in wanted]:
            _, node = self._kept.pop(name)
            node.remove()
        for name, node in wanted.items():
            if name not in self._kept or self._kept[name][0] != node.look:
                self._kept.pop(name, None)
                self._kept[name] = (node.look, node.make(name))

    def __getitem__(self, name: str) -> SceneNodeHandle:
        return self._kept[name][1]
