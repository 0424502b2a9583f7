"""A real photo against real terrain: place and heading, where the store is of its surroundings."""

import numpy as np
import pytest

from skyline import DemOptions, MatchConfig, Matcher, Narrowing, build_places, read_dem

FITTED_HEADING_DEG = 275.96
"""From true north: a fit of all of the camera's angles with its place held."""


@pytest.mark.slow
def test_heading_of_the_webcam_is_found(shared_data, tmp_path):
    dem = shared_data / "rofental" / "dem_rofental_50.asc"
    terrain = read_dem([dem], DemOptions(crs="EPSG:32632"))
    station = terrain.frame.from_lonlat(10.78277, 46.79586)
    around_deg = 10.77077, 46.78786, 10.79477, 46.80386
    build_places(terrain, tmp_path / "station.h5", bounds_deg=around_deg)
    # The field of view was fitted with the angles: it is known.
    matcher = Matcher(tmp_path / "station.h5", config=MatchConfig(fov_sd_share=0.002))
    photo = shared_data / "rofental" / "hintereisferner_webcam.jpg"
    near = Narrowing(near=(10.78277, 46.79586, 0.8))
    result = matcher.match(photo, fov_deg=78.7, narrowing=near)
    # Whether the matcher stands by it is the confidence's matter: places along the line of sight
    # fit nearly as well.
    best = result.candidates[0]
    place = best.easting_m, best.northing_m
    assert np.hypot(*np.subtract(place, station)) < 200.0
    assert abs(best.heading_deg - FITTED_HEADING_DEG) < 1.0
    # Clouds touch the ridge: columns in front of them are left out rather than guessed.
    assert 0.7 < np.isfinite(result.skyline.row_px).mean() < 1.0
