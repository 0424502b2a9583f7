"""DEMs that are no file here, wherever a DEM is named: addresses, virtual rasters, STAC items."""

import json

import numpy as np
import pytest
from range_server import serve_apart
from rasterio.transform import from_origin
from scenes import NORTH_M, SPACING_M, WEST_M, fractal, geotiff_of

from skyline import FetchError, InputError, Matcher, read_dem

SIZE = 128
"""Rows and columns of each of two tiles, side by side."""
SIGNATURE = "?signature=" + "0123456789" * 40
"""Longer than a file's name may be."""


def west_of(name):
    return WEST_M + "ab".index(name) * SIZE * SPACING_M


def item(href, west_m=WEST_M, assets=None):
    """Return a STAC item of one tile."""
    return {
        "type": "Feature",
        "stac_version": "1.0.0",
        "stac_extensions": ["https://stac-extensions.github.io/projection/v1.1.0/schema.json"],
        "id": href,
        "collection": "dem",
        "geometry": None,
        "properties": {
            "datetime": "2021-04-22T00:00:00Z",
            "proj:epsg": 32632,
            "proj:shape": [SIZE, SIZE],
            "proj:transform": [SPACING_M, 0.0, west_m, 0.0, -SPACING_M, NORTH_M],
        },
        "links": [],
        "assets": assets or {"data": {"href": href, "type": "image/tiff; application=geotiff"}},
    }


def collection(*items):
    return {"type": "FeatureCollection", "stac_version": "1.0.0", "features": items}


def virtual():
    """Return a virtual raster over both tiles, as gdalbuildvrt writes it."""
    sources = "".join(
        f'<SimpleSource><SourceFilename relativeToVRT="1">{name}.tif'
        f'</SourceFilename><SrcRect xOff="0" yOff="0" xSize="{SIZE}" ySize="{SIZE}"/>'
        f'<DstRect xOff="{at * SIZE}" yOff="0" xSize="{SIZE}" ySize="{SIZE}"/></SimpleSource>'
        for at, name in enumerate("ab")
    )
    return (
        f'<VRTDataset rasterXSize="{2 * SIZE}" rasterYSize="{SIZE}"><SRS>EPSG:32632</SRS>'
        f"<GeoTransform>{WEST_M}, {SPACING_M}, 0, {NORTH_M}, 0, {-SPACING_M}</GeoTransform>"
        f'<VRTRasterBand dataType="Float32" band="1">{sources}</VRTRasterBand></VRTDataset>'
    )


def tiles():
    heights = 1500.0 + fractal(SIZE, 2 * SIZE, 300.0, seed=4)
    made = {}
    for name, half in zip("ab", np.hsplit(heights, 2), strict=True):
        transform = from_origin(west_of(name), NORTH_M, SPACING_M, SPACING_M)
        made[f"{name}.tif"] = geotiff_of(half, transform=transform)
    return made


def on_server(address):
    """Return the files of the server."""
    files = tiles()
    files["a.tif" + SIGNATURE] = files["a.tif"]
    files["both.vrt"] = virtual().encode()
    items = [item(f"{address}/{name}.tif", west_of(name)) for name in "ab"]
    files["items.json"] = json.dumps(collection(*items)).encode()
    files["page.tif"] = b"<html>This is no DEM.</html>" * 20
    return {f"/{name}": content for name, content in files.items()}


@pytest.fixture(scope="module")
def server():
    with serve_apart(on_server) as apart:
        yield apart


@pytest.fixture(scope="module")
def folder(server, tmp_path_factory):
    """Files here: both tiles, and files that name tiles here or on the server."""
    folder = tmp_path_factory.mktemp("dems")
    for name, content in tiles().items():
        (folder / name).write_bytes(content)
    (folder / "here.vrt").write_text(virtual())
    there = [item(f"{server.address}/{name}.tif", west_of(name)) for name in "ab"]
    slope = {"href": f"{server.address}/b.tif", "type": "image/tiff; application=geotiff"}
    with_slope = item("", assets=there[0]["assets"] | {"slope": slope})
    written = {"type": "application/xml", "href": f"{server.address}/a.xml"}
    for name, content in {
        "items.json": collection(*there),
        "two.json": collection(with_slope),
        "none.json": collection(item("", assets={"metadata": written})),
        "gone.json": collection(item(f"{server.address}/gone.tif")),
    }.items():
        (folder / name).write_text(json.dumps(content))
    return folder


@pytest.fixture(scope="module")
def plain(folder):
    return read_dem([folder / "a.tif", folder / "b.tif"])


def test_every_name_of_both_tiles_gives_both_tiles(server, folder, plain):
    names = "{folder}/here.vrt", "{server}/both.vrt", "{folder}/items.json"
    for name in (*names, 'STACIT:"{server}/items.json"'):
        terrain = read_dem(name.format(server=server.address, folder=folder))
        assert terrain.digest == plain.digest


@pytest.mark.parametrize("prefix", ["", "/vsicurl/"])
def test_addresses_are_tiles_like_files(server, plain, prefix):
    paths = [f"{prefix}{server.address}/{name}.tif" for name in "ab"]
    terrain = read_dem(paths)
    assert terrain.digest == plain.digest
    assert terrain.provenance.files == tuple(paths)


def test_nothing_but_the_dem_is_asked_for(server):
    server.asked()
    read_dem(f"{server.address}/a.tif{SIGNATURE}")
    requests = server.asked()
    assert {path for _, path, _ in requests} == {f"/a.tif{SIGNATURE}"}
    assert any(ranges for _, _, ranges in requests)


def test_one_asset_of_several_is_named(folder, plain):
    with pytest.raises(InputError, match=r"name one of them: STACIT.*asset=data, .*asset=slope"):
        read_dem(folder / "two.json")
    terrain = read_dem(f'STACIT:"{folder / "two.json"}":asset=data')
    np.testing.assert_array_equal(terrain.heights_m, plain.heights_m[:, :SIZE])


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("{server}/gone.tif", FetchError, "404.*check the address"),
        ("http://127.0.0.1:9/a.tif", FetchError, "[Cc]onnect.*whether the server is up"),
        ("{folder}/gone.json", FetchError, "gone.tif"),
        ("http://me:secret@127.0.0.1:9/a.tif?key=secret", FetchError, "^http://127.0.0.1:9/a.tif "),
        ("{server}/page.tif", InputError, "cannot be read as a raster"),
        ("{folder}/none.json", InputError, "No compatible asset"),
    ],
)
def test_a_failure_is_one_line(server, folder, name, error, message):
    with pytest.raises(error, match=message) as refused:
        read_dem(name.format(server=server.address, folder=folder))
    assert "\n" not in str(refused.value)
    assert "secret" not in str(refused.value)


def test_commands_take_addresses(server, folder, plain, run, tmp_path):
    address, place = f"{server.address}/both.vrt", "10.345,46.755"
    facts = json.loads(run("info", address, "--json").out)
    assert (facts["digest"], facts["files"]) == (plain.digest, [address])
    here = run("horizon", folder / "here.vrt", "--at", place).ok()
    assert run("horizon", address, "--at", place).out == here.out
    store = tmp_path / "store.h5"
    assert run("build", address, "-o", store, "--spacing", "300").code == 0
    with Matcher(store, dem=address) as matcher:
        assert matcher.terrain.digest == plain.digest
    refused = run("info", f"{server.address}/gone.tif{SIGNATURE}")
    assert (refused.code, refused.err.count("\n")) == (1, 1)
    assert "404" in refused.err
    assert "signature" not in refused.err


def test_a_store_contacts_no_server_that_the_user_has_not_named(server, tmp_path, run, caplog):
    store, address = tmp_path / "store.h5", f"{server.address}/a.tif{SIGNATURE}"
    assert run("build", address, "-o", store, "--spacing", "300").code == 0
    server.asked()
    with Matcher(store) as matcher:
        assert matcher.terrain is None
    assert server.asked() == []
    assert "--dem" in caplog.text
