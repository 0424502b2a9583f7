"""The interface of matchers, Skyline's own and other packages'."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Self

from skyline.arrays import BoolArray
from skyline.errors import InputError
from skyline.match.other_projection import OtherProjection
from skyline.match.prior import Prior
from skyline.match.rays import Rays
from skyline.match.screen import AlikePlaces
from skyline.match.shard import Shard
from skyline.pose.pose import Pose
from skyline.pose.poses import Poses
from skyline.progress import StepProgress, silent
from skyline.render.horizon import RenderedScene
from skyline.store.read import Store
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

MATCHERS = "skyline.matchers"
"""Group of the entry points by which all matchers are found."""
BY_RENDERING = "this needs rendering: use the full matcher, refine, and give the DEM"


class SearchMethod(ABC):
    """A way to search a store for the pose of a photo.

    A package adds one by an entry point of the group `MATCHERS` that names a subclass. Only `open`,
    `eyes` and `search` must be written; the rest is for methods that render.
    """

    holds: ClassVar[str]
    """The kind of rows of the stores that are searched: ``places`` or ``renderings``."""
    renders: ClassVar[bool] = False
    """Whether `open` gets the terrain and a scene to render, where the DEM can be read."""
    finds_fov: ClassVar[bool] = False
    """Whether an unknown field of view is found with the pose."""
    takes_prior: ClassVar[bool] = False
    """Whether a search may be narrowed, or pulled to the place that a photo notes."""

    @classmethod
    @abstractmethod
    def open(
        cls, store: Store, terrain: HeightField | None = None, scene: RenderedScene | None = None
    ) -> Self:
        """Return the method for an open store.

        The store is not empty, and is closed afterwards.
        """

    @classmethod
    def joined(cls, methods: Sequence[Self]) -> Self:
        """Return one method for the areas of several methods.

        Its poses have `Poses.in_areas`, with the areas in the order of ``methods``.
        """
        raise InputError(
            f"this matcher searches stores of one elevation model, and these are of {len(methods)};"
            " use the full matcher, or search them one after another"
        )

    def by_shards(self, shards: Sequence[Sequence[Shard]], at_once: int) -> Self:
        """Return this method with places in other processes, by area.

        ``at_once`` shards are asked at a time.
        """
        raise InputError("only the full matcher can search by parts of the places")

    @abstractmethod
    def eyes(self) -> Viewpoints:
        """Return the eyes of the store, evenly thinned if very many."""

    @abstractmethod
    def search(self, rays: Rays, prior: Prior, top: int, report: StepProgress = silent) -> Poses:
        """Return up to ``top`` poses that fit a photo, best first.

        Parameters
        ----------
        rays : Rays
            The photo's skyline: u, v and weight, (R,) each, and its field of view.
        prior : Prior
            What is known of the pose; `NOTHING_KNOWN` unless `takes_prior`.
        top : int
            Most poses to return, 1 or more.
        report : callable
            To be called with the name of a step and the share of it that is done, 0 to 1.

        Raises
        ------
        InputError
            The search is narrowed to no place.
        """

    def search_together(
        self,
        photos: Sequence[tuple[Rays, Prior]],
        top: int,
        report: StepProgress = silent,
    ) -> tuple[list[Poses], BoolArray]:
        """Return the best common places of photos of one eye.

        Each photo's poses, up to ``top``, are at the same places in the same order. The second
        value, (N,) bool, says which of the N photos agree; a photo that does not was likely taken
        at another place.
        """
        raise InputError(BY_RENDERING)

    def likely_places(
        self, photos: Sequence[tuple[Rays, Prior]], report: StepProgress = silent
    ) -> tuple[Poses, AlikePlaces]:
        """Return how photos of one eye compare with all searched places.

        The poses are fits without rendering. Raises `InputError` where the search is narrowed to no
        place.
        """
        raise InputError("this matcher knows no probabilities; use the full one")

    def fitted(self, rays: Rays, start: Pose, prior: Prior, about_start: Rays) -> Poses:
        """Return a pose refined from a start, or none.

        ``about_start`` are the photo's rays with fields of view about the start's.
        """
        raise InputError(BY_RENDERING)

    def other_projection(self, rays: Rays, best: Pose, prior: Prior) -> OtherProjection | None:
        """Return the likeliest other projection of a photo; None if unknown."""
        return None
