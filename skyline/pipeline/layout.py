"""Which viewpoints a store is built of."""

from dataclasses import dataclass

from skyline.geodesy import Rectangle
from skyline.planning.adaptive import Blocks, blocks_of
from skyline.planning.uniform import uniform_grid
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

DEFAULT_LOSS = 0.2
"""Of views, for places lying apart; docs/accuracy.md has what others cost and find."""

DEFAULT_TILE_M = 10_000.0
"""400 viewpoints at 500 m: seconds to minutes of work, little of it lost with a worker."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where viewpoints are, and how the area is cut where it is built by tiles."""

    spacing_m: float | None = None
    """Between viewpoints of a uniform grid; None for places that are planned."""
    tile_m: float = DEFAULT_TILE_M
    """Side of the square tiles, which lie at whole multiples of it."""
    bounds_deg: tuple[float, float, float, float] | None = None
    """W, S, E, N in degrees; by default all of the terrain."""
    loss: float = DEFAULT_LOSS
    """Of places that are planned: the share of the views, 60 degrees wide, that may be lost."""

    @property
    def record(self) -> dict[str, object]:
        """What the store's config says: nothing of tiles, for they leave no trace."""
        if self.spacing_m is None:
            return {"planner": "adaptive", "loss": self.loss, "bounds_deg": self.bounds_deg}
        return {"planner": "uniform", "spacing_m": self.spacing_m, "bounds_deg": self.bounds_deg}

    def work(
        self, terrain: HeightField, area: Rectangle, eye_height_m: float
    ) -> Viewpoints | Blocks:
        """Return what there is to render in an area of the map."""
        if self.spacing_m is None:
            return blocks_of(area)
        return uniform_grid(terrain, self.spacing_m, area, eye_height_m)
