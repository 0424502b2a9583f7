"""What is said of elevation models, maps and boxes that are refused, in one line each."""

import gzip
import math
import re
import subprocess
import sys

import numpy as np
import pytest
import rasterio
import xarray
from dem_scenes import (
    SIZE,
    WHOLE,
    array_of,
    colours,
    east,
    in_feet,
    in_unit,
    mountains,
    packed,
    ridges,
    rough_tiles,
    side_by_side,
    tile_at,
    west_tile,
)
from pyproj import CRS
from rasterio.transform import Affine, from_origin
from rasterio.warp import Resampling, reproject
from refusals import assert_says
from scenes import FRAME, UTM, field_of, write_dem

from skyline.errors import MissingFileError, OffMapError
from skyline.geodesy.bounds import check_bounds
from skyline.geodesy.map_frame import Frame
from skyline.terrain.dem import read_dem
from skyline.terrain.field_files import save_field
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline.terrain.viewpoints import stand_at

ONES = np.ones((4, 4), np.int16)
IN_UTM = DemOptions(crs=UTM)


@pytest.fixture
def folder(tmp_path):
    """A folder with one tile, a.tif."""
    return west_tile(tmp_path / "dems")


class TestFiles:
    @pytest.mark.parametrize(
        ("given", "said"),
        [
            ([], "no DEM file"),
            ("", "without a name"),
            (None, "expected paths, a DataArray"),
            (b"a.tif", "expected paths, a DataArray"),
            (np.ones((4, 4)), "expected paths, a DataArray"),
            (np.array(1.0), "expected paths, a DataArray"),
            ([None], "expected paths, a DataArray"),
        ],
        ids=repr,
    )
    def test_what_names_no_file(self, given, said):
        assert_says(said, lambda: read_dem(given))

    @pytest.mark.parametrize(
        ("name", "said"),
        [
            ("no.tif", r"no\.tif"),
            ("x" * 300 + ".tif", "no file"),
            ("*.tif", "name its folder, or the files"),
        ],
    )
    def test_files_that_are_not_there(self, tmp_path, name, said):
        assert_says(said, lambda: read_dem(tmp_path / name), MissingFileError)

    def test_a_folder_without_elevation_files(self, tmp_path):
        assert_says("has no elevation files", lambda: read_dem(tmp_path))
        (tmp_path / "._a.tif").write_bytes(b"hidden")
        (tmp_path / "b.tif").mkdir()
        assert_says("has no elevation files", lambda: read_dem(tmp_path))
        (tmp_path / "README.txt").write_text("tiles of the east")
        said = r"no elevation files among README\.txt; name"
        assert_says(said, lambda: read_dem(tmp_path))

    @pytest.mark.parametrize("name", ["c.tif", "gone.img"])
    def test_a_link_to_nothing(self, folder, name):
        (folder / name).symlink_to(folder / "nothing")
        assert_says(f"{name} is a link", lambda: read_dem(folder), MissingFileError)

    @pytest.mark.parametrize("content", [b"hello", b""])
    def test_not_a_raster(self, tmp_path, content):
        (tmp_path / "a.tif").write_bytes(content)
        assert_says("cannot be read as a raster", lambda: read_dem(tmp_path / "a.tif"))

    def test_gdal_prints_nothing(self, tmp_path):
        path = write_dem(tmp_path / "a.tif", np.ones((300, 300), np.int16), compress="deflate")
        path.write_bytes(path.read_bytes()[:600])
        assert_says(r"a\.tif cannot be read as a raster", lambda: read_dem(path))
        program = f"""
from skyline import InputError, read_dem
try:
    read_dem({str(path)!r})
except InputError as error:
    raise SystemExit(error.exit_code)
"""
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (2, b"", b"")

    def test_damaged_gzip(self, tmp_path):
        path, good = tmp_path / "N0E0.hgt.gz", gzip.compress(bytes(2 * 1201**2), 1)
        for content, said in (
            (b"not gzip", "cannot be unpacked"),
            (good[: len(good) // 2], "cannot be unpacked"),
            (good[:-300] + bytes(300), "cannot be unpacked"),
            (b"", "is empty; fetch it again"),
            (gzip.compress(b"short"), "cannot be read as a raster"),
        ):
            path.write_bytes(content)
            assert_says(said, lambda: read_dem(path))

    def test_several_rasters_in_one_file(self, tmp_path, shared_data):
        lakes = tmp_path / "lakes.nc"
        lakes.symlink_to(shared_data / "sierra" / "lakes_topo.nc")
        assert_says(f"name one of them: netcdf:{lakes}:dem", lambda: read_dem(lakes))
        assert_says(r"several rasters \(netcdf:.*:dem.* name its", lambda: read_dem(tmp_path))
        assert_says("cannot be read", lambda: read_dem(f"netcdf:{lakes}:nothing"))

    def test_latitudes_that_are_even_on_a_map_of_mercator_only(self, tmp_path):
        # The middle of 46 to 48 degrees on that map is 47.0094 degrees, 1 km off.
        lat = np.degrees(np.arcsin(np.tanh(np.linspace(*np.arctanh(np.sin(np.radians([46, 48])))))))
        lon = 9.0 + 0.04 * np.arange(50)
        heights = xarray.DataArray(mountains((50, 50)), {"lat": lat, "lon": lon}, ("lat", "lon"))
        heights.lat.attrs["units"], heights.lon.attrs["units"] = "degrees_north", "degrees_east"
        heights.to_dataset(name="z").to_netcdf(tmp_path / "mercator.nc", engine="scipy")
        said = "mercator.nc has coordinates along lat that are not even; resample it"
        assert_says(said, lambda: read_dem(tmp_path / "mercator.nc", DemOptions(crs="EPSG:4326")))

    @pytest.mark.parametrize("dims", [("lat", "lon"), ("lon", "lat")])
    def test_longitudes_before_latitudes(self, tmp_path, dims):
        """The only summit stands at 46.7 N, 9.9 E."""
        heights = np.zeros((10, 11), np.float32)
        heights[7, 9] = 100.0
        at = {"lat": 46.0 + 0.1 * np.arange(10), "lon": 9.0 + 0.1 * np.arange(11)}
        array = xarray.DataArray(heights, at, ("lat", "lon"), name="z")
        array.lat.attrs["units"], array.lon.attrs["units"] = "degrees_north", "degrees_east"
        path, degrees = tmp_path / "dem.nc", DemOptions(crs="EPSG:4326")
        array.transpose(*dims).to_netcdf(path, engine="scipy")
        if dims == ("lon", "lat"):
            assert_says("dimension lon before its latitudes", lambda: read_dem(path, degrees))
        else:
            assert read_dem(path, degrees).height_at(lon=9.9, lat=46.7) > 50.0

    def test_a_saved_field_that_is_cut_short(self, tmp_path):
        path = tmp_path / "dem.terrain"
        save_field(field_of(mountains()), path)
        path.write_bytes(path.read_bytes()[:-3000])
        said = "holds no elevation model that skyline saved"
        assert_says(said, lambda: read_dem(path))


class TestRasters:
    @pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
    @pytest.mark.parametrize(
        ("heights", "options", "crs", "said"),
        [
            (np.ones((4, 4, 2), np.int16), {}, None, r"a\.tif has 2 bands"),
            (ONES, {"crs": None}, None, "--crs"),
            (ONES, {"crs": None}, "EPSG:99999", "not understood"),
            (ONES, {"crs": None}, "rubbish", "not understood"),
            (ONES, {"crs": None}, "\udcff", "not understood"),
            (ONES, {"transform": Affine.identity()}, None, "no georeference"),
            (ONES, {"crs": "EPSG:4978"}, None, "Geocentric"),
            (ONES, {"transform": Affine(30.0, 5.0, 0.0, 5.0, -30.0, 0.0)}, None, "gdalwarp"),
            (
                np.full((4, 4), -9999.0, np.float32),
                {"nodata": -9999.0},
                None,
                "all samples are nodata",
            ),
            (
                ONES,
                {"crs": None, "transform": from_origin(9.8, 46.8, 0.0003, 0.0003)},
                UTM,
                "samples 0.3 mm apart in WGS 84 / UTM zone 32N",
            ),
            (ONES.astype(np.complex64), {}, None, "expected real heights"),
            (ONES - 32000, {}, None, "beyond 30000 m"),
            (
                ONES,
                {"transform": Affine(np.nan, 0.0, 0.0, 0.0, np.nan, 0.0)},
                None,
                "no georeference",
            ),
        ],
    )
    def test_that_are_no_dem(self, tmp_path, heights, options, crs, said):
        path = write_dem(tmp_path / "a.tif", heights, **options)
        assert_says(said, lambda: read_dem(path, DemOptions(crs=crs)))

    def test_of_a_palette(self, tmp_path):
        path = write_dem(tmp_path / "map.tif", np.ones((9, 9), np.uint8))
        with rasterio.open(path, "r+") as dataset:
            dataset.write_colormap(1, {1: (0, 90, 0)})
        assert_says("colours of a palette", lambda: read_dem(path))

    def test_of_colours_with_an_alpha_band(self, tmp_path):
        assert_says("has 4 bands", lambda: read_dem(colours(tmp_path / "a.tif")))

    @pytest.mark.parametrize(
        ("text", "options", "said"),
        [
            # GDAL places a grid without both corners at 0, 0 and says nothing.
            (
                "ncols 2\nnrows 2\nxllcenter 5e5\nyllcorner 5e6\ncellsize 30\n1 2\n3 4\n",
                IN_UTM,
                "lacks a corner",
            ),
            (
                "ncols 2\nnrows 2\nxllcorner 5e5\nyllcorner 5e6\ncellsize 30\n1 2\n3 4\n",
                DemOptions(),
                "--crs",
            ),
            (
                "ncols 2\nnrows 2\nxllcorner 5e5\nyllcorner 5e6\ncellsize 30\n1 2 3\n4 5 6\n",
                IN_UTM,
                "has 6 values, and its header says 2 x 2",
            ),
            # GDAL reads these points as a grid with zeros between them.
            (
                "".join(f"{x} {y} 5\n" for y in range(5) for x in (0, 1, 30, 47)),
                IN_UTM,
                "lie apart on a grid of 5 x 48",
            ),
        ],
    )
    def test_of_text(self, tmp_path, text, options, said):
        path = tmp_path / ("a.asc" if text.startswith("ncols") else "a.txt")
        path.write_text(text)
        assert_says(said, lambda: read_dem(path, options))

    def test_of_a_shaded_relief(self, tmp_path):
        canopy, relief = (np.full((4, 4), most, np.uint8) for most in (120, 121))
        assert read_dem(write_dem(tmp_path / "a.tif", canopy)).heights_m.max() == 120.0
        assert read_dem(in_unit(tmp_path / "b.tif", "m", relief)).heights_m.max() == 121.0
        path = write_dem(tmp_path / "c.tif", relief)
        assert_says("has 8 bits and values up to 121, as a shaded", lambda: read_dem(path))

    @pytest.mark.parametrize(
        ("name", "is_read"),
        [
            ("slope", False),
            ("Slope (degrees)", False),
            ("hillshade", False),
            ("aspect", False),
            ("elevation", True),
            ("North Slope", True),
            ("slope-corrected heights", True),
        ],
    )
    def test_of_values_derived_from_heights(self, tmp_path, name, is_read):
        path = write_dem(tmp_path / "a.tif", np.full((9, 9), 30.0, np.float32))
        with rasterio.open(path, "r+") as dataset:
            dataset.descriptions = (name,)
        array = array_of().rename(name)
        if is_read:
            read_dem(path)
            read_dem(array, IN_UTM)
            return
        said = f"names its values '{re.escape(name)}'; expected heights"
        assert_says(said, lambda: read_dem(path))
        assert_says(said, lambda: read_dem(array, IN_UTM))
        with rasterio.open(path, "r+") as dataset:
            dataset.units = ("m",)
        assert read_dem(path).height_range_m == (30.0, 30.0)

    def test_with_a_scale_of_zero(self, tmp_path):
        path = write_dem(tmp_path / "a.tif", ONES)
        with rasterio.open(path, "r+") as dataset:
            dataset.scales = (0.0,)
        assert_says("has the scale 0", lambda: read_dem(path))

    @pytest.mark.parametrize("unit", ["degree", "m/s", "m²", "10 cm", "1"])
    def test_in_a_unit_that_is_no_known_length(self, tmp_path, unit):
        path = in_unit(tmp_path / "dem.tif", unit, np.ones((2, 2), np.float32))
        assert_says(f"are in {unit!r}", lambda: read_dem(path))

    @pytest.mark.parametrize(
        ("col", "said"), [(80, r"stands 4\d\.\d m above the tiles beside"), (78, "more than 30 m")]
    )
    def test_in_tiles_of_other_ground(self, tmp_path, col, said):
        paths = rough_tiles(tmp_path, 0, col, 47.0)
        assert_says(f"{said}.*another unit or datum", lambda: read_dem(paths))

    def test_above_all_ground(self, tmp_path):
        path = write_dem(tmp_path / "dem.tif", np.where(mountains() > 1500.0, 9999.0, mountains()))
        assert_says("up to 9999 m, more than any .* --nodata 9999", lambda: read_dem(path))

    def test_below_zero_without_a_sign(self, tmp_path):
        # A slope from 336 m down to -260 m by 4 m a sample: 65,276 is kept for -260.
        heights = np.tile(336 - 4 * np.arange(150), (60, 1)).astype(np.int16)
        read_dem(write_dem(tmp_path / "signed.tif", heights))
        path = write_dem(tmp_path / "wrapped.tif", heights.view(np.uint16))
        said = "65276 to 65532 that join its other heights as -260 to -4 m.*numpy.int16"
        assert_says(said, lambda: read_dem(path))

    @pytest.mark.parametrize("how", [Resampling.bilinear, Resampling.cubic])
    def test_between_the_value_of_voids_and_ground(self, tmp_path, how):
        # A plain of 1,000 m, half of it void, moved by a third of a sample: the cubic one rises
        # beside the voids to about 1,700 m.
        heights = np.where(np.arange(80) < 40, np.float32(-9999.0), np.float32(1000.0))
        moved = np.empty((80, 80), np.float32)
        reproject(
            np.tile(heights, (80, 1)), moved, resampling=how, src_crs=UTM, dst_crs=UTM,
            src_transform=from_origin(5e5, 5.2e6, 30.0, 30.0),
            dst_transform=from_origin(5e5 + 10.0, 5.2e6 - 10.0, 30.0, 30.0),
        )  # fmt: skip
        path = write_dem(tmp_path / "dem.tif", moved)
        assert_says("with walls round them, as a void value", lambda: read_dem(path))

    def test_in_feet_that_nothing_names(self, tmp_path):
        read_dem(write_dem(tmp_path / "metres.tif", ridges()))
        feet = write_dem(tmp_path / "feet.tif", ridges() / 0.3048)
        said = "50 % of the steps .* steeper than 45 degrees.* --units ft, or m if they are metres"
        assert_says(said, lambda: read_dem(feet))

    def test_whose_unit_is_ambiguous(self, tmp_path):
        said = r"is in US survey foot, and nothing names .*--crs EPSG:2227\+6360 for US feet"
        assert_says(said, lambda: read_dem(in_feet(tmp_path / "feet.tif")))
        both = in_unit(tmp_path / "both.tif", "m", np.ones((2, 2), np.float32), f"{UTM}+6360")
        said = "in m by the band and in US survey foot by the vertical axis"
        assert_says(said, lambda: read_dem(both))

    def test_whose_datum_is_not_known(self, tmp_path):
        """MGI, on Bessel's ellipsoid, lies 100 m aside of WGS 84 in Austria."""
        crs = "+proj=utm +zone=32 +ellps=bessel +units=m"
        unknown = write_dem(tmp_path / "a.tif", ONES, crs)
        assert_says("PROJ does not know how its datum lies to WGS 84", lambda: read_dem(unknown))
        known = write_dem(tmp_path / "b.tif", ONES, f"{crs} +towgs84=577.3,90.1,463.9")
        modern = write_dem(tmp_path / "c.tif", ONES, "+proj=utm +zone=32 +ellps=GRS80 +units=m")
        for path in (known, modern):
            assert read_dem(path).heights_m.shape == ONES.shape

    @pytest.mark.parametrize(
        ("crs", "corner", "said"),
        [
            ('LOCAL_CS["mine",UNIT["metre",1]]', (0.0, 0.0), "expected a geographic or projected"),
            ("EPSG:2985", (3e5, 2e5), "PROJ cannot transform"),
            ("EPSG:4326", (500_000.0, 5_200_000.0), "not a place in WGS 84"),
            (UTM, (1e9, 5e6), "not a place in WGS 84 / UTM zone 32N"),
            # Easting and northing of a place in the Alps, swapped.
            (UTM, (5.2e6, 5e5), r"at 3\.\d+° N, 4\d\.\d+° E, far off the area for which"),
            ("EPSG:4326", (10.0, 90.0019), "has a pole in its middle"),
        ],
    )
    def test_whose_places_cannot_be_known(self, tmp_path, crs, corner, said):
        transform = from_origin(*corner, 1e-3, 1e-3)
        path = write_dem(tmp_path / "a.tif", ONES, crs, transform=transform)
        assert_says(said, lambda: read_dem(path))


class TestTiles:
    @pytest.mark.parametrize(
        ("transform", "crs", "said"),
        [
            (from_origin(500_165.0, 5_200_000.0, 30.0, 30.0), UTM, "0.50 columns off"),
            (from_origin(500_150.0, 5_200_000.0, 10.0, 10.0), UTM, "spacing of 10 x 10"),
            (from_origin(500_150.0, 5_200_000.0, 30.0, 30.0), "EPSG:32633", "zone 33N"),
            (from_origin(900_500_000.0, 5_200_000.0, 30.0, 30.0), UTM, "spans"),
        ],
    )
    def test_that_do_not_fit(self, tmp_path, transform, crs, said):
        heights = np.ones((200, 5), np.float32)
        first = tile_at(tmp_path, heights, 0, 0)
        second = write_dem(tmp_path / "b.tif", heights, crs, transform=transform)
        assert_says(said, lambda: read_dem([first, second]))

    def test_above_the_geoid_and_above_the_ellipsoid(self, tmp_path):
        above_ellipsoid = CRS.from_epsg(32632).to_3d().to_wkt()
        tiles = side_by_side(tmp_path, ("EPSG:32632+5773", "m"), (above_ellipsoid, "m"))
        assert_says("above the geoid and .* above the ellipsoid", lambda: read_dem(tiles))

    def test_under_a_raster_of_other_values(self, folder):
        east(folder / "b.tif")
        east(folder / "c_slope.tif", np.full((SIZE, SIZE), 30.0, np.float32))
        said = r"c_slope\.tif covers ground of .* name the"
        assert_says(said, lambda: read_dem(folder))


def damaged_zip(folder):
    packed(folder / "b.zip", east(folder / "b.tif", compress=None))
    content = bytearray((folder / "b.zip").read_bytes())
    content[content.index(b"b.tif") + 400] ^= 255
    (folder / "b.zip").write_bytes(content)


DOUBTS = {
    "cut short": lambda folder: (folder / "b").write_bytes((folder / "a.tif").read_bytes()[:100]),
    "empty": lambda folder: (folder / "b.tif").write_bytes(b""),
    "a page": lambda folder: (folder / "N46E010.hgt").write_text("<html>no</html>"),
    "no archive": lambda folder: (folder / "b.hgt.zip").write_text("<html>no</html>"),
    "damaged archive": damaged_zip,
    "not unpacked": lambda folder: (folder / "b.7z").write_bytes(b"7z\xbc\xaf\x27\x1c" + bytes(99)),
    "points off a grid": lambda folder: (folder / "b.xyz").write_text(
        "0 0 5\n1 0 5\n0 7 5\n16 7 5\n"
    ),
    "short samples": lambda folder: east(folder / "b.bil", driver="EHdr").write_bytes(bytes(99)),
    "no place": lambda folder: write_dem(
        folder / "b.tif", WHOLE, None, transform=rasterio.Affine.identity()
    ),
}


@pytest.mark.parametrize("doubt", DOUBTS)
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_file_that_may_be_a_tile_stops_the_folder_and_is_named(folder, doubt):
    DOUBTS[doubt](folder)
    assert_says(r"dems/(b|N46E010)", lambda: read_dem(folder, IN_UTM))


class TestArrays:
    @pytest.mark.parametrize(
        ("array", "options", "said"),
        [
            (array_of(), None, "no coordinate reference system"),
            (array_of("row", "column"), IN_UTM, "expected y, x or lat, lon"),
            (array_of().drop_vars("x"), IN_UTM, "no coordinates along x"),
            (
                array_of().assign_coords(x=array_of().x.assign_attrs(units="km")),
                IN_UTM,
                "along x in 'km'",
            ),
            (array_of().isel(y=[0, 1, 3, 4]), IN_UTM, "along y that are not even"),
            (array_of().isel(y=[]), IN_UTM, "has no samples; check how it was cut out"),
            (array_of() * np.nan, IN_UTM, "holds no height"),
            (
                array_of().assign_coords(
                    spatial_ref=xarray.DataArray(0, attrs={"grid_mapping_name": "unheard_of"})
                ),
                None,
                "is not understood",
            ),
        ],
        ids=lambda value: value if isinstance(value, str) else "",
    )
    def test_that_are_no_dem(self, array, options, said):
        assert_says(said, lambda: read_dem(array, options))

    def test_of_another_type(self):
        said = "is of type Dataset; expected paths, a DataArray"
        assert_says(said, lambda: read_dem(array_of().to_dataset()))

    def test_of_a_dataset_that_is_closed(self, tmp_path):
        with rasterio.open(write_dem(tmp_path / "a.tif", ONES)) as dataset:
            pass
        said = "an open rasterio dataset"
        assert_says(said, lambda: read_dem(dataset))

    @pytest.mark.parametrize(
        ("corner_and_steps", "frame", "said"),
        [
            ((np.nan, 0.0, 30.0, 30.0), FRAME, "the first sample is at nan"),
            ((9.0, 47.0, 1 / 3600, 1 / 3600), FRAME, "grid in degrees needs a CRS in degrees"),
            (
                (1.09e6, 5.9e6, 30.0, 30.0),
                Frame.from_crs("EPSG:3857"),
                r"EPSG:3857 slopes .* wrong by up to 10\.8",
            ),
        ],
    )
    def test_on_a_grid_that_is_none(self, corner_and_steps, frame, said):
        assert_says(said, lambda: HeightField(np.zeros((3, 3)), *corner_and_steps, frame))


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"lon": 9.9},
        {"easting_m": 1.0, "lat": 46.8},
        {"easting_m": 1.0, "northing_m": 1.0, "lon": 9.9, "lat": 46.8},
    ],
)
def test_half_a_place_or_two(given):
    said = f"a place is given by {', '.join(given) or 'nothing'}; expected easting_m"
    assert_says(said, lambda: field_of(np.zeros((3, 3))).height_at(**given))


def test_a_place_off_the_map_is_told_how_far():
    """The map of 3 x 3 samples reaches 60 m to the east."""
    lon, lat = FRAME.to_lonlat(160.0, -30.0)
    said = "the place at .* is 100 m off the map; the corners of the DEM lie within lon"
    field = field_of(np.zeros((3, 3)))
    assert_says(said, lambda: stand_at(field, lon=lon, lat=lat), OffMapError)


@pytest.mark.parametrize(
    ("crs", "said"),
    [("EPSG:4326", "metric"), ("EPSG:2227", "metric"), ("rubbish", "not understood")],
)
def test_a_crs_that_is_not_metric_is_no_frame(crs, said):
    assert_says(said, lambda: Frame.from_crs(crs))


@pytest.mark.parametrize(
    "bounds",
    [(180, 1, -180, 2), (9, 1, 9, 2), (9, 1, 8, 2), (179, 1, 181, 2), (math.nan, 1, 2, 3)],
)
def test_bounds_that_are_no_box(bounds):
    assert_says("longitudes from -180 to 180", lambda: check_bounds(bounds))
