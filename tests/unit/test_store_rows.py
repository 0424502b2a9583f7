"""The reference store against a plain list of rows."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from store_files import CHUNK, assert_holds, build
from store_rows import HEADER, rows

from skyline.errors import (
    InputError,
    StoreError,
)
from skyline.features import NO_KEYPOINT
from skyline.store import (
    create_store,
    open_store,
)
from skyline.views import Views


class TestRoundTrip:
    @pytest.mark.parametrize("count", [0, 1, CHUNK - 1, CHUNK, CHUNK + 1, 5 * CHUNK + 3])
    def test_rows_come_back_unchanged(self, tmp_path: Path, count: int) -> None:
        with open_store(build(tmp_path / "s.h5", count)) as store:
            assert len(store) == store.committed == count
            assert_holds(store, count)

    def test_header_comes_back(self, tmp_path: Path) -> None:
        with open_store(build(tmp_path / "s.h5", 1)) as store:
            assert store.header == HEADER
            assert store.header.package_version
            assert store.path == tmp_path / "s.h5"

    def test_contract_with_other_programs(self, tmp_path: Path) -> None:
        """Names, types and attributes of the store's format, seen by plain h5py."""
        build(tmp_path / "s.h5", 40)
        with h5py.File(tmp_path / "s.h5", "r") as file:
            assert file.attrs["schema"] == "skyline-store"
            assert file.attrs["schema_version"] == 3
            assert file.attrs["frame"] == HEADER.frame_wkt
            assert file.attrs["dem_digest"] == HEADER.dem_digest
            assert json.loads(file.attrs["config"]) == HEADER.config
            assert file.attrs["renderer"] == HEADER.renderer
            assert isinstance(file.attrs["package_version"], str)
            assert file["committed"][()] == 40
            kinds = {name: data.dtype.str for name, data in file["views"].items()}
            assert kinds == {
                "easting": "<f8",
                "northing": "<f8",
                "eye_elevation_m": "<f8",
                "heading": "|u1",
                "elevation_tan": "<f4",
                "depth_m": "<f4",
                "flags": "|u1",
                "checksum": "<u4",
            }
            assert file["features/keypoint_column"].dtype == "<u2"
            for data in (*file["views"].values(), *file["features"].values()):
                assert data.chunks
                assert data.maxshape[0] is None
                assert len(data) == 40

    @pytest.mark.parametrize(
        "index",
        [
            0,
            -1,
            slice(3, 9),
            slice(None, None, -7),
            slice(80, 20),
            np.array([90, 2, 2, 41, 3]),
            np.arange(100) % 9 == 4,
            np.array([], dtype=int),
        ],
    )
    def test_any_numpy_index(self, tmp_path: Path, index: object) -> None:
        with open_store(build(tmp_path / "s.h5", 100)) as store:
            assert_holds(store, 100, index)

    def test_rows_beyond_the_committed_ones(self, tmp_path: Path) -> None:
        with open_store(build(tmp_path / "s.h5", 10)) as store:
            for index in (10, -11, np.array([3, 10])):
                with pytest.raises(InputError, match="10 committed rows"):
                    store.views(index)

    @pytest.mark.parametrize("chunk_rows", [1, 7, 100, 1000])
    def test_iteration(self, tmp_path: Path, chunk_rows: int) -> None:
        with open_store(build(tmp_path / "s.h5", 100)) as store:
            parts = list(store.iter_views(chunk_rows))
            assert {len(part) for part in parts[:-1]} <= {chunk_rows}
            np.testing.assert_array_equal(Views.concatenate(parts).depth_m, rows(0, 100)[0].depth_m)
            with pytest.raises(InputError, match="chunk_rows is 0"):
                next(store.iter_views(0))

    def test_locations(self, tmp_path: Path) -> None:
        with open_store(build(tmp_path / "s.h5", 50)) as store:
            locations, views = store.locations(), rows(0, 50)[0]
            assert len(locations) == 50
            for name in ("easting_m", "northing_m", "eye_elevation_m", "heading"):
                np.testing.assert_array_equal(getattr(locations, name), getattr(views, name))

    def test_float64_skylines_are_stored_as_float32(self, tmp_path: Path) -> None:
        views, keypoints = rows(0, 3)
        wide = replace(views, elevation_tan=views.elevation_tan.astype(np.float64))
        with create_store(tmp_path / "s.h5", HEADER) as writer:
            writer.append(wide, keypoints)
        with open_store(tmp_path / "s.h5") as store:
            assert_holds(store, 3)

    def test_appended_arrays_may_be_reused(self, tmp_path: Path) -> None:
        views, keypoints = rows(0, 3)
        with create_store(tmp_path / "s.h5", HEADER) as writer:
            writer.append(views, keypoints)
            views.depth_m[:] = -1.0
            keypoints[:] = 0
        with open_store(tmp_path / "s.h5") as store:
            assert_holds(store, 3)

    def test_smooth_skylines_are_packed(self, tmp_path: Path) -> None:
        """Less than two thirds of the plain bytes at the default width."""
        header = replace(HEADER, width=640, max_keypoints=128)
        u = np.linspace(-1.0, 1.0, 640)
        phase = np.arange(256)[:, np.newaxis] / 40.0
        skyline = (0.2 * np.sin(3.0 * u + phase) + 0.02 * np.sin(40.0 * u)).astype(np.float32)
        one = np.zeros(256)
        views = Views(
            one,
            one,
            one,
            one.astype(np.uint8),
            skyline,
            1e4 * (1.0 + skyline),
            np.zeros(skyline.shape, dtype=np.uint8),
        )
        keypoints = np.full((256, 128), NO_KEYPOINT, dtype=np.uint16)
        with create_store(tmp_path / "s.h5", header) as writer:
            writer.append(views, keypoints)
        plain = 25 + 640 * 9 + 256
        assert (tmp_path / "s.h5").stat().st_size / 256 < plain * 2 / 3

    def test_closed_store_and_writer_say_so(self, tmp_path: Path) -> None:
        writer = create_store(tmp_path / "s.h5", HEADER)
        writer.close()
        writer.close()
        with pytest.raises(StoreError, match="closed"):
            writer.append(*rows(0, 1))
        store = open_store(tmp_path / "s.h5")
        store.close()
        store.close()
        with pytest.raises(StoreError, match="closed"):
            store.views()
