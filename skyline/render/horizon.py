"""The horizon rasterizer: skylines in views of 90 degrees, exact to float32, without an image."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from skyline.camera import DEFAULT_WIDTH, check_width, columns_u, pixel_size
from skyline.geodesy import Curvature
from skyline.render.eyes import in_four_views
from skyline.render.march import NEAR_ERROR_PX, ColumnRenderer, check_tolerance
from skyline.skylines import Views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True)
class RenderConfig:
    """Settings of views of 90 degrees.

    Attributes
    ----------
    width : int
        Columns W of a view.
    tolerance_px : float
        Greatest amount by which a skyline may lie below the exact one; with 0 it is exact to
        float32.
    curvature : Curvature
    """

    width: int = DEFAULT_WIDTH
    tolerance_px: float = 0.05
    curvature: Curvature = field(default_factory=Curvature)


class HorizonRenderer(ColumnRenderer):
    """Renders the skylines of one height field in views of 90 degrees.

    Parameters
    ----------
    width : int
        Columns W of a view.
    curvature : Curvature, optional
        Defaults to the Earth's with k = 0.13.
    tolerance_px : float
        Greatest amount by which v may be less than the exact one; with 0 it is exact to float32.

    Raises
    ------
    InputError
        The width or the tolerance is out of range, or samples are much longer than wide.
    ContextError
        No OpenGL context can be made.
    """

    def __init__(
        self,
        field: HeightField,
        width: int = DEFAULT_WIDTH,
        curvature: Curvature | None = None,
        tolerance_px: float = 0.0,
    ) -> None:
        pixel = pixel_size(check_width(width))
        self.tolerance_px = check_tolerance(tolerance_px, "px")
        super().__init__(
            field,
            columns_u(width),
            np.full(width, self.tolerance_px * pixel),
            NEAR_ERROR_PX * pixel,
            curvature or Curvature(),
        )

    @classmethod
    def of(cls, field: HeightField, config: RenderConfig) -> Self:
        """Return a renderer with the settings of a configuration; raises as the class does."""
        return cls(field, config.width, config.curvature, config.tolerance_px)

    @property
    def description(self) -> str:
        """Name of this rasterizer and of the OpenGL renderer under it, for records."""
        tolerance = f", tolerance {self.tolerance_px:g} px" if self.tolerance_px else ""
        return f"horizon {self.width} columns{tolerance}; {self._context.renderer}"

    def render(self, viewpoints: Viewpoints, headings: ArrayLike | None = None) -> Views:
        """Render skylines.

        Parameters
        ----------
        viewpoints : Viewpoints
            N eyes.
        headings : (N,) array_like of int, optional
            One heading for each eye; by default all four.

        Returns
        -------
        Views
            N views in order, or 4 N: the four headings of a viewpoint follow one another.
        """
        if headings is None:
            eyes, heading = in_four_views(viewpoints)
        else:
            eyes, heading = viewpoints, np.asarray(headings, dtype=np.uint8)
        return Views.concatenate(
            [
                Views(
                    eyes.easting_m[part],
                    eyes.northing_m[part],
                    eyes.eye_elevation_m[part],
                    heading[part],
                    rows.elevation_tan,
                    rows.depth_m,
                    rows.flags,
                )
                for part, rows in self._batches(eyes, heading, np.zeros(len(eyes)))
            ]
        )


def render_views(
    terrain: HeightField, viewpoints: Viewpoints, config: RenderConfig | None = None
) -> Views:
    """Render the skylines of viewpoints to grid north, east, south, west (4 N views)."""
    config = config or RenderConfig()
    with HorizonRenderer.of(terrain, config) as renderer:
        return renderer.render(viewpoints)
