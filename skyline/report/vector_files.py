"""Files of a photo's shapes on the map, and the reverse."""

import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import library, suffix_of
from skyline.files.disk import write_whole
from skyline.files.geojson import DEGREE_DECIMALS, GEOJSON, Json, collection, feature
from skyline.files.shapes import LINE, POINT, POLYGON
from skyline.files.vectors import PHOTO_MEMBER, VERTICES_LAYER
from skyline.geodesy.map_frame import Frame
from skyline.ground.ground_shapes import GroundShape, PhotoShape
from skyline.ground.ground_view import GroundPoints
from skyline.photo.skyline import PhotoForm
from skyline.report.kml import add, add_coordinates, add_polygon, kml_document, xml_bytes

MAP_FILES = (*GEOJSON, ".gpkg", ".kml")
"""Suffixes of shapes on the map."""
_METRE_DECIMALS = 2
_PIXEL_DECIMALS = 2
_NAMES = ("name", "label", "category", "id")
"""Properties that may name a shape; the first one present counts."""


def write_on_map(path: Path, shapes: Sequence[GroundShape], frame: Frame, photo: Path) -> None:
    """Write a photo's shapes on the map.

    Coordinates are longitudes, latitudes (WGS 84) and elevations. The errors of the drawn vertices
    of lines and polygons are the property ``vertices`` of GeoJSON, and the layer of that name in a
    GeoPackage; KML has only the errors of points. Raises `InputError` for another suffix, for a
    file that cannot be written, and for a GeoPackage without GeoPandas.
    """
    suffix = suffix_of(path, MAP_FILES)
    features = [_on_map(one, frame, photo) for one in shapes]
    if suffix == ".gpkg":
        content: str | bytes = _geopackage(path, features)
    elif suffix == ".kml":
        content = _kml(features)
    else:
        content = _text(features)
    write_whole(path, content)


def write_in_photo(path: Path, shapes: Sequence[PhotoShape], photo: Path, form: PhotoForm) -> None:
    """Write shapes of the map in a photo's pixels, as GeoJSON.

    Each part within the photo is a feature, whose property ``hidden`` says whether ground hides it.
    The member ``photo`` has the photo's name and size. Raises `InputError` where the file cannot be
    written.
    """
    size = {"width_px": form.width_px, "height_px": form.height_px}
    features = []
    for one in shapes:
        for part, hidden in one.parts(form.width_px, form.height_px):
            pixels = np.round(part, _PIXEL_DECIMALS).tolist()
            geometry = (POINT, pixels[0]) if one.shape.kind == POINT else (LINE, pixels)
            features.append(feature(*geometry, {**one.shape.properties, "hidden": hidden}))
    write_whole(path, _text(features, **{PHOTO_MEMBER: {"name": photo.name, **size}}))


def _text(features: Sequence[Json], **members: Any) -> str:
    return json.dumps(collection(features, **members), indent=1) + "\n"


def _on_map(found: GroundShape, frame: Frame, photo: Path) -> Json:
    """Return the GeoJSON feature of a shape."""
    kind = found.shape.kind
    rings = [_coordinates(ring, frame).tolist() for ring in found.rings]
    coordinates: Any = rings[0][0] if kind == POINT else rings[0]
    if kind == POLYGON:
        # RFC 7946: outlines are counter-clockwise, holes clockwise, and all are closed.
        coordinates = [
            [*turned, turned[0]]
            for number, ring in enumerate(rings)
            for turned in [ring if _turns_left(ring) == (number == 0) else ring[::-1]]
        ]
    properties = {**found.shape.properties, "photo": photo.name}
    vertices = [_errors(found.vertices, k, frame) for k in range(len(found.vertices))]
    if kind == POINT:
        properties |= vertices[0]
    else:
        properties |= {**_measures(found), "vertices": vertices}
    return feature(kind, coordinates, properties)


def _measures(found: GroundShape) -> Json:
    """Return the figures of a line or a polygon."""
    vertices = found.vertices
    figures: Json = {}
    if found.area is not None:
        figures |= {
            "area_m2": round(found.area.value, _METRE_DECIMALS),
            "area_sd_m2": round(found.area.sd, _METRE_DECIMALS),
        }
    if found.length is not None and found.slope_length_m is not None:
        figures |= {
            "length_m": round(found.length.value, _METRE_DECIMALS),
            "length_sd_m": round(found.length.sd, _METRE_DECIMALS),
            "slope_length_m": round(found.slope_length_m, _METRE_DECIMALS),
        }
    jump_m = 0.0 if found.jump is None else found.jump.far_m - found.jump.near_m
    return figures | {
        "jump_m": round(jump_m, _METRE_DECIMALS),
        "error_m": round(float(np.median(vertices.error_m)), _METRE_DECIMALS),
        "grazing_share": round(float(vertices.is_grazing.mean()), 3),
    }


def _errors(points: GroundPoints, index: int, frame: Frame) -> Json:
    """Return a point's place and its errors."""
    one = points[index : index + 1]
    major_m, minor_m, azimuth = (float(part[0]) for part in one.axes)
    position = {"easting_m": one.easting_m, "northing_m": one.northing_m}
    lon, lat, elevation_m = _coordinates(one, frame)[0].tolist()
    turn_deg = np.degrees(azimuth) + float(frame.convergence_deg(**position)[0])
    return {
        "lon": lon,
        "lat": lat,
        "elevation_m": elevation_m,
        "distance_m": round(float(one.distance_m[0]), _METRE_DECIMALS),
        "error_m": round(float(one.error_m[0]), _METRE_DECIMALS),
        "semi_major_m": round(major_m, _METRE_DECIMALS),
        "semi_minor_m": round(minor_m, _METRE_DECIMALS),
        "azimuth_deg": round(turn_deg % 180.0, 1),
        "grazing": bool(one.is_grazing[0]),
    }


def _coordinates(points: GroundPoints, frame: Frame) -> Float64Array:
    """Return continuous longitudes, latitudes and elevations (N, 3)."""
    lon, lat = frame.to_lonlat(points.easting_m, points.northing_m)
    columns = [np.unwrap(lon, period=360.0), lat, np.round(points.elevation_m, _METRE_DECIMALS)]
    return np.stack([*np.round(columns[:2], DEGREE_DECIMALS), columns[2]], axis=1)


def _turns_left(ring: Sequence[Sequence[float]]) -> bool:
    lon, lat, _ = np.transpose(ring)
    return bool(np.sum(lon * np.roll(lat, -1) - np.roll(lon, -1) * lat) > 0.0)


def _geopackage(path: Path, features: Sequence[Json]) -> bytes:
    """Return a GeoPackage, with layers for kinds of shapes and drawn vertices."""
    geopandas = library("geopandas", f"writing {path}")
    layers: dict[str, list[Json]] = {}
    for number, one in enumerate(features, start=1):
        about = {name: value for name, value in one["properties"].items() if name != "vertices"}
        kind = {POINT: "points", LINE: "lines", POLYGON: "polygons"}[one["geometry"]["type"]]
        layers.setdefault(kind, []).append({**one, "properties": {"shape": number, **about}})
        for vertex in one["properties"].get("vertices", ()):
            position = [vertex["lon"], vertex["lat"], vertex["elevation_m"]]
            drawn = feature(POINT, position, {"shape": number, **vertex})
            layers.setdefault(VERTICES_LAYER, []).append(drawn)
    # Layers are added in a folder of this machine: some network folders lack SQLite's file locks.
    with TemporaryDirectory() as folder:
        file = Path(folder) / "shapes.gpkg"
        for layer, some in layers.items():
            table = geopandas.GeoDataFrame.from_features(some, crs="EPSG:4326")
            table.to_file(file, layer=layer, driver="GPKG", mode="a" if file.exists() else "w")
        return file.read_bytes()


def _kml(features: Sequence[Json]) -> bytes:
    root, document = kml_document()
    for number, one in enumerate(features, start=1):
        properties, geometry = one["properties"], one["geometry"]
        mark = add(document, "Placemark")
        names = (properties[name] for name in _NAMES if properties.get(name) is not None)
        add(mark, "name", str(next(names, f"shape {number}")))
        about = (f"{name}: {value}" for name, value in properties.items() if name != "vertices")
        add(mark, "description", "; ".join(about))
        kind, coordinates = geometry["type"], geometry["coordinates"]
        if kind == POLYGON:
            add_polygon(mark, coordinates)
        else:
            add_coordinates(add(mark, kind), [coordinates] if kind == POINT else coordinates)
    return xml_bytes(root)
