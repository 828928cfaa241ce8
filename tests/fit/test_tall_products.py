"""Products in pieces are those of NumPy, whatever is left over at the ends."""

from __future__ import annotations

import numpy as np
import pytest

from station.fit.tall_products import gram, product, transposed_product


@pytest.mark.parametrize("rows", [0, 1, 63, 1000])
@pytest.mark.parametrize("columns", [0, 1, 63, 64, 65, 141])
def test_products_in_pieces_are_those_in_one(rows: int, columns: int) -> None:
    rng = np.random.default_rng(100)
    A, B, C = rng.normal(size=(rows, columns)), rng.normal(size=(rows, 70)), rng.normal(size=(columns, 70))
    np.testing.assert_allclose(gram(A), A.T @ A, atol=1e-11)  # sums of 1000 products of about 1
    np.testing.assert_allclose(transposed_product(A, B), A.T @ B, atol=1e-11)
    np.testing.assert_allclose(product(A, C), A @ C, atol=1e-11)
