"""Stores whose rows show which row they are."""

from contextlib import contextmanager
from dataclasses import fields, replace

import h5py
import numpy as np

from skyline.geodesy.map_frame import Frame
from skyline.skylines import DEFAULT_MAX_KEYPOINTS, NO_KEYPOINT, Views
from skyline.store.layout import PLACES, RENDERINGS, StoreHeader, columns_of
from skyline.store.places import BINS, DISTANCE_BINS, PHASE_BINS, Places
from skyline.store.write import write_store

WIDTH = 24
VIEWS_HEADER = StoreHeader(
    frame_wkt=Frame.from_crs("EPSG:32632").wkt,
    dem_digest="a1" * 32,
    dem_files=("/dem/davos.tif", "/dem/näfels.tif"),
    config={"planner": "uniform", "spacing_m": 500.0, "bounds": [1, 2, 3, 4]},
    renderer="depth 640 on Mesa",
    width=WIDTH,
)
PLACES_HEADER = replace(VIEWS_HEADER, width=0, holds=PLACES)
HEADERS = {RENDERINGS: VIEWS_HEADER, PLACES: PLACES_HEADER}


def numbered_views(start, stop):
    """Return views and keypoints of rows ``start`` to ``stop``; some columns are NaN."""
    number = np.arange(start, stop)
    skyline = np.sin(0.1 * np.arange(WIDTH) + number[:, np.newaxis]).astype(np.float32)
    skyline[number % 5 == 0, 3:7] = np.nan
    keypoints = np.full((len(number), DEFAULT_MAX_KEYPOINTS), NO_KEYPOINT, dtype=np.uint16)
    keypoints[:, 0] = number % WIDTH
    place = 7.5e5 + number, 5.2e6 - number / 3.0, 1500.0 + number / 7.0
    depth_m = 1000.0 * np.abs(skyline) + number[:, np.newaxis].astype(np.float32)
    flags = ((number[:, np.newaxis] + np.arange(WIDTH)) % 8).astype(np.uint8)
    return Views(*place, (number % 4).astype(np.uint8), skyline, depth_m, flags), keypoints


def numbered_places(start, stop):
    """Return places of rows ``start`` to ``stop``."""
    number = np.arange(start, stop)
    place, row = number.astype(np.float64), number[:, np.newaxis]
    return Places(
        easting_m=7.5e5 + place,
        northing_m=5.2e6 - place / 3.0,
        eye_elevation_m=(1500.0 + place / 7.0).astype(np.float32),
        tolerance_m=np.full(len(number), 25.0, dtype=np.float32),
        first_tan=np.sin(place).astype(np.float32),
        rise=((row * 7 + np.arange(BINS) * 3) % 256).astype(np.uint8).view(np.int8),
        distance=((row + np.arange(DISTANCE_BINS)) % 256).astype(np.uint8),
        phase=((row * 5 + np.arange(PHASE_BINS)) % 256).astype(np.uint8),
    )


def write_rows(path, start, stop, header=VIEWS_HEADER):
    """Write a store of rows ``start`` to ``stop`` of the header's kind."""
    is_places = header.holds == PLACES
    rows = [numbered_places(start, stop)] if is_places else numbered_views(start, stop)
    write_store(path, header, columns_of(header, *rows))
    return path


def assert_holds(store, rows, index=slice(None)):
    """Assert that rows of a store, read in every way there is, are those numbered ``rows``."""
    wanted, last = np.atleast_1d(rows[index]), int(rows.max(initial=-1)) + 1
    if store.header.holds == PLACES:
        chosen = np.atleast_1d(np.arange(len(store))[index])
        got = store.places().take(chosen)
        np.testing.assert_array_equal(store.places().phases(chosen), got.phase)
        whole = numbered_places(0, last)
    else:
        whole, keypoints = numbered_views(0, last)
        got = store.views(index)
        np.testing.assert_array_equal(store.keypoint_columns(index), keypoints[wanted])
    for field in fields(whole):
        expected, actual = getattr(whole, field.name)[wanted], getattr(got, field.name)
        np.testing.assert_array_equal(actual, expected, err_msg=field.name)
        assert actual.dtype == expected.dtype, field.name


@contextmanager
def edited(path):
    """Open a store's file to change it."""
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        yield file


def flip(path, position):
    """Flip a bit of a file."""
    data = bytearray(path.read_bytes())
    data[position] ^= 16
    path.write_bytes(data)


def chunk_of(path, name, chunk):
    """Return the byte at which a chunk of a dataset begins."""
    with h5py.File(path) as file:
        return int(file[name].id.get_chunk_info(chunk).byte_offset)


def damaged_rows(path, header):
    """Write a store of 2,500 rows of which the second chunk is damaged; return its path."""
    write_rows(path, 0, 2500, header)
    flip(path, chunk_of(path, next(iter(header.specs)), 1) + 12)
    return path


def older_store(path):
    """Write the head of a store of an older schema; return its path."""
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        file.attrs["schema"] = "skyline-store"
        file.attrs["schema_version"] = 3
        file.attrs["frame"] = "a text of a variable length"
        file.create_dataset("committed", data=np.uint64(0))
    return path


def hollow_store(path):
    """Write a store of 3,000 places of which those of the second chunk are not there."""
    write_rows(path, 0, 3000, PLACES_HEADER)
    with edited(path) as file:
        values = file["places/phase"][:]
        replace_data("places/phase", **PLACES_HEADER.layout("places/phase", 3000))(file)
        file["places/phase"][:10], file["places/phase"][2500:] = values[:10], values[2500:]
    return path


def replace_data(name, **layout):
    """Return an edit that puts a dataset of another layout in the place of one."""

    def edit(file):
        shape = file[name].shape
        del file[name]
        file.create_dataset(name, **{"shape": shape, **layout})

    return edit
