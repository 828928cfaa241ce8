"""Which pairs are joined: the minimum spanning tree over the scores, its root, and the order from the root outward."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree

from station.errors import InvalidData
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# scipy's spanning tree takes a weight of zero for no edge: all weights are shifted so that the least is this.
LEAST_WEIGHT = 1.0


def spanning_forest(nodes: int, pairs: IntArray, weights: FloatArray) -> IntArray:
    """Indices into `pairs` of the minimum spanning forest.

    The lower its weight, the better an edge a pair is; pairs at 0 or above explain nothing and are none.

    Args:
        nodes: number of parts.
        pairs: (P, 2).
        weights: (P,).

    Raises:
        InvalidData: if the number of edges is not that of a spanning forest.
    """
    useful = np.flatnonzero(np.isfinite(weights) & (weights < 0))
    if not useful.size:
        return useful
    shifted = weights[useful] - weights[useful].min() + LEAST_WEIGHT
    graph = coo_array((shifted, (pairs[useful, 0], pairs[useful, 1])), shape=(nodes, nodes)).tocsr()
    chosen = minimum_spanning_tree(graph).tocoo()
    index = {(int(a), int(b)): int(i) for i, (a, b) in zip(useful, pairs[useful], strict=True)}
    edges = np.array(sorted(index[int(a), int(b)] for a, b in zip(*chosen.coords, strict=True)), dtype=np.intp)
    trees = len(set(components(nodes, pairs[useful])))
    if len(edges) != nodes - trees:
        raise InvalidData(
            f"the spanning tree of {nodes} parts in {trees} trees has {len(edges)} edges; want {nodes - trees}"
        )
    return edges


def contenders(nodes: int, pairs: IntArray, weights: FloatArray, least: FloatArray, edges: IntArray) -> BoolArray:
    """(P,) whether a pair could be an edge of the minimum spanning forest if it had its least weight instead.

    It could if that is below the heaviest edge on the forest's path between its ends, or below 0 where there is none.

    Args:
        nodes: number of parts.
        pairs: (P, 2).
        weights: (P,).
        least: (P,) not above `weights`.
        edges: rows of the minimum spanning forest as it is.
    """
    heaviest = np.zeros((nodes, nodes))
    tree = np.arange(nodes)
    for edge in edges[np.argsort(weights[edges], kind="stable")]:  # Kruskal's order: later edges are heavier
        one, other = (np.flatnonzero(tree == tree[end]) for end in pairs[edge])
        heaviest[np.ix_(one, other)] = weights[edge]
        heaviest[np.ix_(other, one)] = weights[edge]
        tree[other] = tree[one[0]]
    could: BoolArray = least < heaviest[pairs[:, 0], pairs[:, 1]]
    could[edges] = True
    return could


def components(nodes: int, edges: IntArray) -> list[int]:
    """For each node the least node that edges (E, 2) connect it to."""
    label: list[int] = list(range(nodes))
    for pair in edges:  # a few edges; union by relabelling
        low, high = sorted((label[int(pair[0])], label[int(pair[1])]))
        label = [low if x == high else x for x in label]
    return label


def shallowest(nodes: Sequence[int], edges: IntArray) -> int:
    """The node of a tree from which the farthest is nearest; the first of equals."""
    return min(nodes, key=lambda node: max(depths(node, edges).values()))


def depths(root: int, edges: IntArray) -> dict[int, int]:
    """Number of joints between the root and each node of its tree."""
    found = {root: 0}
    for parent, child, _ in outward(root, edges):  # parents come before their children
        found[child] = found[parent] + 1
    return found


def outward(root: int, edges: IntArray) -> list[tuple[int, int, int]]:
    """(parent, child, index of the edge) of a tree's edges (E, 2), each after the one that it hangs from."""
    order: list[tuple[int, int, int]] = []
    reached, waiting = {root}, [root]
    while waiting:
        node = waiting.pop(0)
        for index, pair in enumerate(edges.tolist()):
            if node not in pair:
                continue
            other = pair[0] if pair[1] == node else pair[1]
            if other not in reached:
                order.append((node, other, index))
                reached.add(other)
                waiting.append(other)
    return order
