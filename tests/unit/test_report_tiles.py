"""Relief tiles: where things lie in them, what is empty, which side is lit."""

import io
import math

import numpy as np
import pytest
from PIL import Image
from scenes import field_of

from skyline import InputError, ReliefTiles
from skyline.report.relief_tiles import contours

LON, LAT = 9.8, 46.8


def tile_of(lon, lat, zoom):
    """Return x, y and the pixel of a place, by the formulas of EPSG:3857."""
    east = (lon + 180.0) / 360.0 * 2**zoom
    south = (1.0 - math.asinh(math.tan(math.radians(lat))) / math.pi) / 2.0 * 2**zoom
    return int(east), int(south), 256.0 * (east % 1.0), 256.0 * (south % 1.0)


def picture_of(tiles, zoom, x, y):
    with Image.open(io.BytesIO(tiles.png(zoom, x, y))) as image:
        return np.asarray(image.convert("RGBA")).astype(float)


def centred(heights, spacing_m):
    half_m = (len(heights) - 1) / 2.0 * spacing_m
    return field_of(heights, spacing_m, west_m=-half_m, north_m=half_m)


@pytest.mark.parametrize("zoom", [11, 13, 15])
def test_a_step_in_the_terrain_lies_where_the_map_has_it(zoom):
    """West of the frame's middle meridian it is low, east of it high; so from south to north."""
    spacing_m, count = 20.0, 1001
    low = np.zeros((count, count), np.float32)
    side = np.arange(count) >= count // 2
    x, y, column, row = tile_of(LON, LAT, zoom)
    pixel_m = 40_075_016.686 * math.cos(math.radians(LAT)) / 2**zoom / 256.0
    blur_px = 1.0 + spacing_m / pixel_m
    for is_high, along, at_px in (
        (side, np.s_[int(row), :], column),
        (side[::-1, None], np.s_[:, int(column)], row),
    ):
        tiles = ReliefTiles(centred(low + 300.0 * is_high, spacing_m))
        lightness = picture_of(tiles, zoom, x, y)[along][:, :3].sum(axis=1)
        jump = np.argmax(np.abs(np.diff(lightness)))
        assert abs(jump + 0.5 - at_px) <= 1.0 + blur_px


def test_there_is_nothing_beyond_the_terrain_or_over_holes():
    heights = np.full((400, 400), 500.0, np.float32)
    heights[150:250, 150:250] = np.nan
    tiles = ReliefTiles(centred(heights, 25.0))
    x, y, column, row = tile_of(LON, LAT, 14)
    assert picture_of(tiles, 14, x, y)[int(row), int(column), 3] == 0.0
    west, south, east, north = tiles.bounds_deg
    assert west < LON < east
    assert south < LAT < north
    for lon, lat, alpha in (
        (west + 0.002, LAT, 255.0),
        (west - 0.002, LAT, 0.0),
        (LON, north - 0.002, 255.0),
        (LON, north + 0.002, 0.0),
    ):
        x, y, column, row = tile_of(lon, lat, 14)
        assert picture_of(tiles, 14, x, y)[int(row), int(column), 3] == alpha
    assert picture_of(tiles, 5, 0, 0)[..., 3].max() == 0.0


def test_the_light_comes_from_the_north_west():
    spacing_m = 20.0
    east = spacing_m * (np.arange(501) - 250.0)
    ridge = (800.0 - 0.5 * np.abs(east + east[:, None])).astype(np.float32)
    # A ridge from south-west to north-east, in the middle of the frame.
    tiles = ReliefTiles(centred(ridge, spacing_m))
    seen = []
    for away_deg in (-0.01, 0.01):
        x, y, column, row = tile_of(LON + away_deg, LAT - away_deg, 14)
        seen.append(picture_of(tiles, 14, x, y)[int(row), int(column), :3].sum())
    north_west, south_east = seen
    assert north_west > south_east + 50.0


@pytest.mark.parametrize("at", [(-1, 0, 0), (2, 4, 0), (99, 0, 0)])
def test_a_tile_that_is_none_is_refused(at):
    with pytest.raises(InputError):
        ReliefTiles(field_of(np.zeros((9, 9), np.float32))).png(*at)


def test_contours_run_between_heights_on_their_two_sides():
    heights = np.tile(np.float32([95.0, 98.0, 101.0, 104.0, np.nan, 130.0]), (4, 1))
    # Of the inner pixels 98, 101, 104 and nan, the first has a neighbour beyond 100 m.
    assert contours(heights, 10.0).tolist() == [[True, False, False, False]] * 2
    assert not contours(heights, 50.0)[:, 1:].any()


def test_contours_are_no_closer_than_five_pixels_on_a_steep_slope():
    tiles = ReliefTiles(centred(np.zeros((9, 9), np.float32), 25.0))
    # At 47 degrees north a pixel is 107 km / 2**zoom wide.
    assert tiles.contours_m(15) == 20.0
    assert tiles.contours_m(12) == 200.0
    assert tiles.contours_m(9) is None
