"""Which dictionary the markers of some images are from, for when the one that was named shows none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.perception.corners import MarkerDetector
from station.perception.markers import DICTIONARY_SIZES

Image = NDArray[np.uint8]

# A marker that is there is there in more than one image; one pattern in noise isn't.
LEAST_SIGHTINGS = 2


@dataclass(frozen=True)
class FoundDictionary:
    """A dictionary whose markers are in images.

    Attributes:
        name: of the dictionary; of several that share these markers the smallest.
        ids: markers that were seen, in order.
        images: in how many of the images.
        mirrored: whether the images must be turned left to right to show them.
    """

    name: str
    ids: tuple[int, ...]
    images: int
    mirrored: bool


def find_dictionary(images: Sequence[Image]) -> FoundDictionary | None:
    """The dictionary of OpenCV's that shows most markers in the images; None if none shows any in two of them.

    Of a single image, one sighting is enough. Mirrored images are tried as well.
    """
    best: tuple[int, FoundDictionary] | None = None
    for mirrored in (False, True):
        shown = [np.ascontiguousarray(image[:, ::-1]) for image in images] if mirrored else list(images)
        for name in sorted(DICTIONARY_SIZES, key=DICTIONARY_SIZES.__getitem__):
            sightings, found = _sightings(name, shown)
            if found is not None and (best is None or sightings > best[0]):
                best = sightings, FoundDictionary(name, found[0], found[1], mirrored)
    return None if best is None else best[1]


def _sightings(name: str, images: Sequence[Image]) -> tuple[int, tuple[tuple[int, ...], int] | None]:
    """How often markers of a dictionary were seen that were seen often enough; their ids, and in how many images."""
    detector = MarkerDetector(name)
    seen = [detector.detect(image, expected=()).ids.tolist() for image in images]
    counts = Counter(n for ids in seen for n in ids)
    kept = {n: count for n, count in counts.items() if count >= min(LEAST_SIGHTINGS, len(images))}
    if not kept:
        return 0, None
    return sum(kept.values()), (tuple(sorted(kept)), sum(any(n in kept for n in ids) for ids in seen))
