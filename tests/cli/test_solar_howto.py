"""The how-to page's annual shading loss against the plain computation of the same."""

import math
from contextlib import chdir, redirect_stdout
from datetime import UTC, datetime, timedelta
from io import StringIO

import numpy as np
import pytest
from documents import ROOT, blocks_of
from rasterio.transform import from_origin
from scenes import write_dem

from skyline import sky_view_factor

ephem = pytest.importorskip("ephem")
pvlib = pytest.importorskip("pvlib")

PAGE = ROOT / "docs" / "howto" / "horizons.md"


@pytest.fixture
def valley(tmp_path):
    """A valley from west to east, whose southern wall stands 25 degrees over its bottom."""
    (tmp_path / "alps").mkdir()
    count, step = 400, 1.0 / 1800.0
    north_m = (np.arange(count) - 200.0)[:, None] * -step * 111_200.0
    heights = 1000.0 + np.where(north_m < 0.0, 0.47, 0.2) * np.abs(north_m) + np.zeros(count)
    heights += 40.0 * np.sin(np.arange(count) / 9.0)
    transform = from_origin(9.85 - 200 * step, 46.75 + 200 * step, step, step)
    path = tmp_path / "alps" / "N46E009.tif"
    write_dem(path, heights.astype(np.float32), "EPSG:4326", transform=transform)
    return tmp_path


def plain_loss(elevation_deg, eye_m, tilt_deg, facing_deg):
    """Return the loss, summed step by step, with another sun than pvlib's."""
    observer, body = ephem.Observer(), ephem.Sun()
    observer.lon, observer.lat, observer.elevation = math.radians(9.85), math.radians(46.75), eye_m
    observer.compute_pressure()
    tilt, facing = math.radians(tilt_deg), math.radians(facing_deg)
    at, steps = datetime(2026, 1, 1, tzinfo=UTC), []
    while at.year == 2026:
        observer.date = at.replace(tzinfo=None)
        body.compute(observer)
        height = float(body.alt)
        up = math.sin(height)
        if up > 0.0:
            ghi = 1098.0 * up * math.exp(-0.059 / up)
            cosine = math.cos(tilt) * up
            cosine += math.sin(tilt) * math.cos(height) * math.cos(float(body.az) - facing)
            place = math.degrees(body.az) / 0.5
            left, share = int(place) % 720, place % 1.0
            line = (1.0 - share) * elevation_deg[left] + share * elevation_deg[(left + 1) % 720]
            is_lit = math.degrees(height) > line
            steps.append((ghi, math.degrees(height), at.timetuple().tm_yday, cosine, is_lit))
        at += timedelta(minutes=10)
    ghi, height_deg, day, cosine, is_lit = np.array(steps).T
    split = pvlib.irradiance.erbs(ghi, 90.0 - height_deg, day)
    beam = split["dni"] * np.maximum(cosine, 0.0)
    free = beam + split["dhi"] * (1.0 + math.cos(tilt)) / 2.0
    factor = sky_view_factor(np.arange(720) * 0.5, elevation_deg, tilt_deg, facing_deg)
    return 1.0 - (beam * is_lit + split["dhi"] * factor).sum() / free.sum()


def test_the_annual_loss_of_the_page_is_that_of_the_plain_computation(valley):
    block = next(block for block in blocks_of(PAGE) if "aoi_projection" in block.text)
    names, printed = {}, StringIO()
    with chdir(valley), redirect_stdout(printed):
        exec(compile(block.text, PAGE.name, "exec"), names)
    place = names["place"]
    assert place.elevation_deg[360] == pytest.approx(25.2, abs=1.0)
    loss = plain_loss(place.elevation_deg, float(place.eye_elevation_m), 30.0, 180.0)
    assert 0.05 < loss < 0.4
    assert names["loss"] == pytest.approx(loss, abs=0.002)
    assert f"{100.0 * names['loss']:.1f} %" in printed.getvalue()
