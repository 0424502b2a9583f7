"""How skylines are rendered, and the renderer and the store header that this asks for."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from skyline.camera import DEFAULT_WIDTH
from skyline.errors import InputError, StoreError, StoreMismatchError
from skyline.geodesy import Curvature
from skyline.render.horizon import HorizonRenderer
from skyline.render.panorama import DEFAULT_TOLERANCE_DEG
from skyline.store import RowCoding, StoreHeader
from skyline.store.header import PLACES
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M

ROWS = ("compact", "exact")
"""How a store may hold its rows."""


@dataclass(frozen=True, slots=True)
class RenderConfig:
    """How skylines are rendered, and how a store holds them.

    Attributes
    ----------
    width : int
        Columns W of a view.
    tolerance_px : float
        How far a skyline may fall short of the exact one; 0 is exact but for float32.
    eye_height_m : float
        Eye above ground, where a viewpoint does not say.
    keypoint_tolerance_px : float
        How far a skyline may be from the polyline whose vertices are its keypoints.
    rows : str
        "compact" (skylines within 0.005 px, depths within 0.1 %, a fifth of the bytes) or "exact".

    Raises
    ------
    InputError
        No such way to hold rows.
    """

    width: int = DEFAULT_WIDTH
    tolerance_px: float = 0.05
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    keypoint_tolerance_px: float = 1.0
    curvature: Curvature = field(default_factory=Curvature)
    rows: str = "compact"

    def __post_init__(self) -> None:
        if self.rows not in ROWS:
            raise InputError(f"rows is {self.rows!r}; expected one of {', '.join(ROWS)}")


@dataclass(frozen=True, slots=True)
class PlaceConfig:
    """How places are rendered.

    Attributes
    ----------
    eye_height_m : float
        Eye above ground.
    tolerance_deg : float
        How far a skyline may fall short of the exact one, degrees of elevation; 0 is exact but
        for float32.
    """

    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    tolerance_deg: float = DEFAULT_TOLERANCE_DEG
    curvature: Curvature = field(default_factory=Curvature)


BuildConfig = RenderConfig | PlaceConfig
"""How the rows of a store are rendered, and with that which rows: renderings or places."""


def make_renderer(terrain: HeightField, config: RenderConfig) -> HorizonRenderer:
    """Return the renderer a configuration asks for."""
    return HorizonRenderer(terrain, config.width, config.curvature, config.tolerance_px)


def store_header(
    terrain: HeightField, renderer: str, config: BuildConfig, plan: dict[str, object]
) -> StoreHeader:
    """Return the header of a store that a renderer, given by its description, fills by a plan."""
    settings: dict[str, Any] = {"rasterizer": "panorama"} | asdict(config)
    rows: dict[str, Any] = {"holds": PLACES}
    if isinstance(config, RenderConfig):
        settings["rasterizer"] = "horizon"
        coding = RowCoding.within(config.width) if settings.pop("rows") == "compact" else None
        rows = {"width": config.width, "coding": coding}
    return StoreHeader(
        frame_wkt=terrain.frame.wkt,
        dem_digest=terrain.digest,
        dem_files=terrain.provenance.files,
        config={**plan, **settings, "dem_options": dict(terrain.provenance.options)},
        renderer=renderer,
        **rows,
    )


def read_dem_of(header: StoreHeader, paths: Sequence[str | Path] = ()) -> HeightField:
    """Read the DEM a store was built from, as it was read then.

    ``paths`` say where it lies now; by default where it lay.

    Raises
    ------
    StoreMismatchError
        What lies there is another DEM.
    MissingFileError
        Nothing lies there.
    """
    options = DemOptions.from_json(header.config.get("dem_options"))
    terrain = read_dem(list(paths) or list(header.dem_files), options)
    check_dem(header, terrain)
    return terrain


def check_dem(header: StoreHeader, terrain: HeightField) -> None:
    """Raise `StoreMismatchError` unless a store was built from this terrain."""
    if terrain.digest != header.dem_digest:
        raise StoreMismatchError(
            f"the DEM's digest is {terrain.digest[:12]}, the store was built from "
            f"{header.dem_digest[:12]} ({', '.join(header.dem_files) or 'no file'}); give that DEM"
        )


def curvature_of(header: StoreHeader) -> Curvature:
    """Return the curvature a store was rendered with; the default where it does not say.

    Raises `StoreError` where it says what is no curvature.
    """
    stored = header.config.get("curvature")
    if not isinstance(stored, dict):
        return Curvature()
    names = {f.name for f in fields(Curvature)}
    try:
        return Curvature(**{name: value for name, value in stored.items() if name in names})
    except (TypeError, ValueError) as error:
        raise StoreError(
            f"the store's curvature is {stored!r}, which is none ({error}); build it anew"
        ) from error
