"""Products of tall matrices, in pieces that the linear algebra library computes in the thread that asks.

Frames are shared out between threads by `parallel`. Were each product shared out again, threads would wait for each
other most of the time; and sums would be made in another order on another computer.
"""

from __future__ import annotations

import numpy as np

from station.logs import FloatArray

# OpenBLAS keeps products of at most 64 x 64 x 64 multiplications in one thread (interface/gemm.c).
TILE = 64
ONE_THREAD = TILE**3


def transposed_product(A: FloatArray, B: FloatArray) -> FloatArray:
    """(m, n) A^T B of A (N, m) and B (N, n), N large."""
    found = np.zeros((A.shape[1], B.shape[1]))
    for i in range(0, A.shape[1], TILE):
        for j in range(0, B.shape[1], TILE):
            found[i : i + TILE, j : j + TILE] = _tile(A[:, i : i + TILE], B[:, j : j + TILE])
    return found


def gram(A: FloatArray) -> FloatArray:
    """(n, n) A^T A of A (N, n), N large."""
    found = np.zeros((A.shape[1], A.shape[1]))
    for i in range(0, A.shape[1], TILE):
        for j in range(i, A.shape[1], TILE):
            tile = _tile(A[:, i : i + TILE], A[:, j : j + TILE])
            found[i : i + TILE, j : j + TILE] = tile
            found[j : j + TILE, i : i + TILE] = tile.T
    return found


def _tile(A: FloatArray, B: FloatArray) -> FloatArray:
    """A^T B of A (N, m) and B (N, n), m and n at most `TILE`."""
    (N, m), n = A.shape, B.shape[1]
    rows = ONE_THREAD // max(m * n, 1)
    pieces = N // rows
    A_t = np.swapaxes(A[: pieces * rows].reshape(pieces, rows, m), -1, -2)
    whole = (A_t @ B[: pieces * rows].reshape(pieces, rows, n)).sum(axis=0)
    return whole + A[pieces * rows :].T @ B[pieces * rows :]


def product(A: FloatArray, B: FloatArray) -> FloatArray:
    """(N, n) A B of A (N, m), N large, and B (m, n)."""
    (N, m), n = A.shape, B.shape[1]
    rows = max(ONE_THREAD // max(m * n, 1), 1)
    pieces = N // rows
    whole = (A[: pieces * rows].reshape(pieces, rows, m) @ B).reshape(pieces * rows, n)
    return np.concatenate([whole, A[pieces * rows :] @ B])
