"""Residuals of a fit are read as they were written, and nothing else is taken for them."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from station.errors import InvalidFile
from station.fit.image_checks import Finding, ModelChecks, Residuals, Size
from station.formats.residuals import read_residuals, write_residuals


def some(count: int = 7) -> Residuals:
    rng = np.random.default_rng(1)
    left = 0.1 * rng.standard_normal((count, 4, 2))
    left[2:3] = np.nan
    finding = Finding("marker", "marker 3 moved", (Size(0.4, "mm", 0.1),), 1e-7, 3, "lid", 4.1, 0.02, ("the camera",))
    return Residuals(
        t_s=np.arange(count) / 30,
        marker_id=np.arange(count) % 3,
        part=tuple(("lid", "base")[k % 2] for k in range(count)),
        tilt_rad=np.where(np.arange(count) == 2, np.nan, 0.3),
        corners_px=rng.uniform(0, 400, (count, 4, 2)),
        residual_px=left,
        outward_px=left.sum(axis=(1, 2)),
        sigma_px=np.full(count, 0.1),
        chi2=rng.uniform(0, 9, count),
        inlier=rng.uniform(0, 1, count),
        doubtful=np.arange(count) == 5,
        size_px=(640, 480),
        checks=ModelChecks((finding,), 12, 0.01, ("the edge shift",)),
    )


def written(tmp_path: Path, residuals: Residuals) -> Path:
    path = tmp_path / "residuals.parquet"
    with path.open("wb") as file:
        write_residuals(residuals, file)
    return path


@pytest.mark.parametrize("count", [7, 0])
def test_residuals_are_read_as_they_were_written_to_the_last_bit(tmp_path: Path, count: int) -> None:
    told = some(count)
    back = read_residuals(written(tmp_path, told))
    for field in fields(Residuals):
        have, want = getattr(back, field.name), getattr(told, field.name)
        if isinstance(want, np.ndarray):
            np.testing.assert_array_equal(have, want, err_msg=field.name)
            assert have.dtype == want.dtype, field.name
        else:
            assert have == want, field.name


def test_other_programs_find_columns_with_units_and_no_nan(tmp_path: Path) -> None:
    table = pq.read_table(written(tmp_path, some()))
    assert table.column("residual_px").to_pylist()[2] == [None] * 8
    assert table.column("tilt_rad").null_count == 1
    assert json.loads(table.schema.metadata[b"checks"])["findings"][0]["marker_id"] == 3


def changed(path: Path, how: str) -> None:
    table = pq.read_table(path)
    metadata = dict(table.schema.metadata)
    if how == "torn":
        path.write_bytes(path.read_bytes()[:300])
        return
    if how == "other schema":
        metadata[b"schema"] = b"residuals/2"
    elif how == "no column":
        table = table.drop_columns(["chi2"])
    elif how == "other type":
        at = table.column_names.index("marker_id")
        table = table.set_column(at, "marker_id", table.column("marker_id").cast("string"))
    else:
        told = json.loads(metadata[b"checks"])
        told["findings"][0]["surprise"] = 1
        metadata[b"checks"] = json.dumps(told).encode()
    pq.write_table(table.replace_schema_metadata(metadata), path)


@pytest.mark.parametrize("how", ["torn", "other schema", "no column", "other type", "unknown key"])
def test_a_file_that_is_none_is_refused_with_its_name(tmp_path: Path, how: str) -> None:
    path = written(tmp_path, some())
    changed(path, how)
    with pytest.raises(InvalidFile, match=r"residuals\.parquet.*fit again"):
        read_residuals(path)
