"""Two tiles, here and on a server, and the files that name them: virtual rasters, STAC items."""

import json

import numpy as np
from rasterio.transform import from_origin
from scenes import NORTH_M, SPACING_M, WEST_M, fractal, geotiff_of

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


def files_beside(address, folder):
    """Write both tiles, and files that name tiles here or on the server; return the folder."""
    for name, content in tiles().items():
        (folder / name).write_bytes(content)
    (folder / "here.vrt").write_text(virtual())
    there = [item(f"{address}/{name}.tif", west_of(name)) for name in "ab"]
    slope = {"href": f"{address}/b.tif", "type": "image/tiff; application=geotiff"}
    with_slope = item("", assets=there[0]["assets"] | {"slope": slope})
    written = {"type": "application/xml", "href": f"{address}/a.xml"}
    for name, content in {
        "items.json": collection(*there),
        "two.json": collection(with_slope),
        "none.json": collection(item("", assets={"metadata": written})),
        "gone.json": collection(item(f"{address}/gone.tif")),
    }.items():
        (folder / name).write_text(json.dumps(content))
    return folder
