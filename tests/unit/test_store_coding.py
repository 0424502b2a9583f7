"""Compact rows: the stated error, gaps, and a decoder that another program could write."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from store_rows import HEADER, WIDTH, rows

from skyline.errors import InputError, StoreError, StoreMismatchError
from skyline.store import RowCoding, as_stored, create_store, open_for_append, open_store
from skyline.views import Views

CODING = RowCoding.within(WIDTH)
COMPACT = replace(HEADER, coding=CODING)
PIXEL = 2.0 / WIDTH


def assert_within_the_stated_error(read: np.ndarray, given: np.ndarray, bound: np.ndarray) -> None:
    np.testing.assert_array_equal(np.isnan(read), np.isnan(given))
    error = np.abs(read.astype(np.float64) - given)
    # Beside the rounding to a step there is that to float32.
    allowed = bound * (1.0 + 1e-6) + 2.0**-23 * np.abs(given)
    assert np.nanmax(error - allowed, initial=-np.inf) <= 0.0


ordinates = arrays.arrays(
    np.float32,
    (5, WIDTH),
    elements=st.one_of(st.just(np.nan), st.floats(-1e4, 1e4, width=32)),
)


class TestCoding:
    @settings(max_examples=60)
    @given(ordinates)
    def test_ordinates(self, tan: np.ndarray) -> None:
        codes = CODING.tan_codes(tan)
        read = CODING.elevation_tan(codes)
        assert read.dtype == np.float32
        assert_within_the_stated_error(read, tan, 0.005 * PIXEL)
        np.testing.assert_array_equal(
            CODING.elevation_tan(CODING.tan_codes(read)), read, "rounded twice is rounded once"
        )

    @settings(max_examples=60)
    @given(ordinates)
    def test_depths(self, depth_m: np.ndarray) -> None:
        depth_m = np.abs(depth_m) + np.float32(0.01)
        codes = CODING.depth_codes(depth_m)
        read = CODING.depth_m(codes)
        assert_within_the_stated_error(read, depth_m, 0.001 * np.abs(depth_m))
        np.testing.assert_array_equal(CODING.depth_codes(read), codes)

    def test_every_column_may_be_missing(self) -> None:
        nothing = np.full((2, WIDTH), np.nan)
        assert not CODING.tan_codes(nothing).any()
        assert np.isnan(CODING.elevation_tan(CODING.tan_codes(nothing))).all()

    def test_straight_skylines_have_one_code(self) -> None:
        step = CODING.tan_step
        slope = np.arange(WIDTH) * 50.0 * step
        assert (CODING.tan_codes(slope[np.newaxis])[0, 2:] == 1).all()

    def test_errors_are_as_asked(self) -> None:
        coding = RowCoding.within(640, tan_error_px=0.02, depth_error=0.01)
        assert coding.tan_error_px(640) == pytest.approx(0.02)
        assert coding.depth_error == pytest.approx(0.01)

    @pytest.mark.parametrize("steps", [(0.0, 1e-3), (1e-3, float("nan")), (2.0, 1e-3), (1, 1e-3)])
    def test_steps_out_of_range(self, steps: tuple[float, float]) -> None:
        with pytest.raises(InputError, match="_step is"):
            RowCoding(*steps)

    def test_values_that_no_code_stands_for(self) -> None:
        with pytest.raises(InputError, match="beyond what compact rows hold"):
            CODING.tan_codes(np.array([[1e9, 0.0]]))
        with pytest.raises(InputError, match="beyond what compact rows hold"):
            CODING.tan_codes(np.array([[np.inf, 0.0]]))
        with pytest.raises(InputError, match=r"is -1\.0 m"):
            CODING.depth_codes(np.array([[-1.0, 5.0, np.nan]]))


class TestCompactStore:
    def test_rows_are_within_the_error_and_as_said_beforehand(self, tmp_path: Path) -> None:
        views, keypoints = rows(0, 100)
        with create_store(tmp_path / "s.h5", COMPACT) as writer:
            writer.append(views, keypoints)
        with open_store(tmp_path / "s.h5") as store:
            assert store.header == COMPACT
            read = store.views()
            np.testing.assert_array_equal(store.keypoint_columns(), keypoints)
        assert_within_the_stated_error(read.elevation_tan, views.elevation_tan, 0.005 * PIXEL)
        depth_m = np.maximum(views.depth_m, 1e-3)
        assert_within_the_stated_error(read.depth_m, depth_m, 0.001 * depth_m)
        foretold = as_stored(COMPACT, views)
        for name in ("elevation_tan", "depth_m", "flags", "easting_m"):
            np.testing.assert_array_equal(getattr(foretold, name), getattr(read, name))
            assert getattr(foretold, name).dtype == getattr(read, name).dtype

    def test_decoded_by_plain_h5py(self, tmp_path: Path) -> None:
        """As `skyline.store.coding` tells another program to."""
        views, keypoints = rows(0, 40)
        with create_store(tmp_path / "s.h5", COMPACT) as writer:
            writer.append(views, keypoints)
        with h5py.File(tmp_path / "s.h5") as file:
            steps = json.loads(file.attrs["rows"])
            code = file["views/elevation_tan"][:].astype(np.int64)
            depth_code = file["views/depth_m"][:].astype(np.int64)
        assert steps["rows"] == "compact"

        def unzigzag(code: np.ndarray) -> np.ndarray:
            return np.where(code == 0, 0, np.where(code % 2 == 1, (code - 1) // 2, -code // 2))

        slope = np.cumsum(unzigzag(code), axis=1)
        slope[code == 0] = 0
        tan = np.cumsum(slope, axis=1) * steps["tan_step"]
        tan[code == 0] = np.nan
        depth_m = np.exp(np.cumsum(unzigzag(depth_code), axis=1) * steps["depth_log_step"])
        depth_m[depth_code == 0] = np.nan
        with open_store(tmp_path / "s.h5") as store:
            np.testing.assert_array_equal(store.views().elevation_tan, tan.astype(np.float32))
            np.testing.assert_allclose(store.views().depth_m, depth_m, rtol=1e-6)

    def test_resumed_store_is_the_unbroken_one(self, tmp_path: Path) -> None:
        for name, stops in (("whole", [90]), ("broken", [10, 45, 90])):
            start = 0
            create_store(tmp_path / name, COMPACT).close()
            for stop in stops:
                with open_for_append(tmp_path / name, COMPACT) as writer:
                    writer.append(*rows(start, stop))
                start = stop
        with open_store(tmp_path / "whole") as whole, open_store(tmp_path / "broken") as broken:
            for name, values in whole.stored().items():
                np.testing.assert_array_equal(values, broken.stored()[name])

    @pytest.mark.parametrize(
        ("wanted", "said"),
        [
            (HEADER, "rows is 'compact' there, 'exact' here"),
            (replace(HEADER, coding=RowCoding.within(WIDTH, 0.1)), "coding is RowCoding"),
        ],
    )
    def test_rows_of_another_coding_are_refused(
        self, tmp_path: Path, wanted: object, said: str
    ) -> None:
        create_store(tmp_path / "s.h5", COMPACT).close()
        with pytest.raises(StoreMismatchError, match=said):
            open_for_append(tmp_path / "s.h5", wanted)

    def test_less_than_the_target(self, tmp_path: Path) -> None:
        """A smooth skyline of 640 columns with its depths in under 1.2 kB."""
        header = replace(HEADER, width=640, coding=RowCoding.within(640))
        u = np.linspace(-1.0, 1.0, 640)
        phase = np.arange(256)[:, np.newaxis] / 40.0
        skyline = (0.2 * np.sin(3.0 * u + phase) + 0.02 * np.sin(40.0 * u)).astype(np.float32)
        one = np.zeros(256)
        flags = np.zeros(skyline.shape, dtype=np.uint8)
        views = Views(one, one, one, one.astype(np.uint8), skyline, 1e4 * (1 + skyline), flags)
        with create_store(tmp_path / "s.h5", header) as writer:
            writer.append(views, np.zeros((256, HEADER.max_keypoints), dtype=np.uint16))
        assert (tmp_path / "s.h5").stat().st_size / 256 < 1200

    @pytest.mark.parametrize(
        "said", ['{"rows": "packed"}', "[]", '{"rows": "compact", "tan_step": 1e-3}', "{"]
    )
    def test_a_coding_from_elsewhere(self, tmp_path: Path, said: str) -> None:
        create_store(tmp_path / "s.h5", COMPACT).close()
        with h5py.File(tmp_path / "s.h5", "r+", libver=("v110", "v110")) as file:
            file.attrs["rows"] = said
        with pytest.raises(StoreError, match=r"rows|cannot be opened"):
            open_store(tmp_path / "s.h5")
