"""The search for how a camera was held at a known place.

The place is known to some metres, and the heading is not known. The skylines of the place and of a
ring of places around it are rendered, and a pose is fitted to each of them from every heading, as
retrieval fits poses to the places of a store. The best poses are then refined by rendering, with
the known place as a prior, so the eye may move.

Most eyes stand on the ground. Where a photo notes a height far above it, poses are fitted from
there as well (`skyline.match.eye_prior.Standing`), and the costs of both tell which is right.

An orientation is trusted where the skylines fit, no other heading fits nearly as well, and the
fit leaves little doubt about the heading. The weights of these three were learned like the
confidence of a match (`skyline.match.confidence`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from skyline.angles import angle_between_deg
from skyline.arrays import Float64Array, refuse_text
from skyline.errors import InputError, printable
from skyline.match import confidence
from skyline.match.blas_threads import one_blas_thread
from skyline.match.eye_prior import EyeHeightPrior, KnownGround, Standing
from skyline.match.joined_shards import JoinedShards
from skyline.match.narrowing import Narrowing
from skyline.match.noted_errors import noted_position_scale_m
from skyline.match.other_projection import find_other_projection
from skyline.match.position_prior import PositionPrior
from skyline.match.prior import Prior
from skyline.match.rays import Rays
from skyline.match.refine import VIEW_WIDTH, Particles, Refinement, RefinementEffort
from skyline.match.retrieval import Retriever
from skyline.match.shard import LocalShard
from skyline.match.solver import TEMPERATURE
from skyline.match.verdict import confidence_in_words, refusal_of, too_little
from skyline.orientation.result import LEAST_CONFIDENCE, Orientation
from skyline.photo.haze import farther_skylines
from skyline.photo.image import Picture
from skyline.photo.noted_place import NotedPlace
from skyline.photo.read import named_skyline
from skyline.photo.skyline import PhotoSkyline
from skyline.pose.pose import Pose
from skyline.pose.pose_errors import ANGLES, ASSUMED
from skyline.pose.poses import Poses
from skyline.render.context import Closeable
from skyline.render.horizon import PanoramaRenderer, RenderConfig, RenderedScene
from skyline.store.places import BINS, Places
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import (
    DEFAULT_EYE_HEIGHT_M,
    Viewpoints,
    check_eye_elevation,
    stand_at_one,
    stand_where_possible,
)

DEFAULT_POSITION_SD_M = 50.0
"""The error of a position that a person reads off a map, or that a phone notes between cliffs."""


class KnownPosition(NamedTuple):
    """Where a camera stood, and how surely, as `Orienter` takes it."""

    lon: float
    lat: float
    elevation_m: float | None
    position_sd_m: float


@dataclass(frozen=True, slots=True)
class HeadingSearch:
    """Which eyes and fits the search for a heading tries."""

    most_position_sd_m: float = 500.0
    """Greatest standard deviation of the position. A place known less well is found by a match."""
    ring: int = 8
    """Places rendered around the known one."""
    takeoff_m: float = 200.0
    """Usual distance of a drone from its take-off; it must stay in sight of its pilot."""
    headings: int = 48
    """Fits that are refined: the best one of each of this many headings."""
    places: int = 32
    """Further fits that are refined: the best ones of all."""
    separation_m: float = 15.0
    """A fit that is nearer than this to a better one and looks the same way is left out."""
    turn_deg: float = 4.0
    """Fits look the same way within this angle."""
    apart_deg: float = 10.0
    """Refined poses that look within this angle of each other are one answer."""
    rivals: int = 6
    """Best poses of other headings that are kept to the end: their fits show how sure a heading is.
    """


_SEARCH = HeadingSearch()
_EFFORT = RefinementEffort(
    shortlist=80, particles=80, likeliest=0, rounds=5, keep_share=0.6, keep_least=10,
    restarts=2, weighed=8, finalists=8, final_rounds=4,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Doubts:
    """Limits beyond which the best pose at a known place is doubtful."""

    eye_sds: float = 3.0
    """Eyes are the same if their heights differ by less than this many standard deviations of the
    terrain model's heights."""
    eye_share: float = 0.2
    """Eyes are also the same if their heights differ by less than this share of the height above
    the ground, since distances of the ground grow by this share."""
    eye_cost: float = TEMPERATURE * math.log(LEAST_CONFIDENCE / (1.0 - LEAST_CONFIDENCE))
    """An eye at another height whose cost is higher by less than this makes the best one
    doubtful."""
    far_sds: float = 4.0
    """A pose farther from the known place than this many standard deviations belongs to another
    place."""
    sure: float = 0.95
    """A photo whose heading is surer than this is not looked at again for a farther skyline."""
    named_cost: float = 20.0
    """A heading whose cost is higher by less than this is named in a refusal."""


_DOUBTS = _Doubts()


class Orienter(Closeable):
    """Finds how cameras were held at one place.

    It serves any number of photos from there, in any thread. `close`, or the end of a ``with``
    block, frees its memory on the GPU.

    Parameters
    ----------
    dem : path, paths, DataArray or HeightField
        The elevation model, which must hold all terrain that is seen from the place.
    lon, lat : float
        The place, degrees (WGS 84).
    elevation_m : float, optional
        Elevation of the eye above the DEM's datum. By default the eye stands on the ground, or at a
        height that the photo notes, and the fit decides.
    position_sd_m : float
        Standard deviation of the position, metres.

    Raises
    ------
    OffMapError
        The place is off the map or on a hole, or the elevation lies more than 200 m below all
        ground within ``position_sd_m``.
    InputError
        ``position_sd_m`` is not above 0, or above 500 m, the elevation is not from -500 to
        20,000 m, or the DEM cannot be read.
    """

    def __init__(
        self,
        dem: Dem,
        *,
        lon: float,
        lat: float,
        elevation_m: float | None = None,
        position_sd_m: float = DEFAULT_POSITION_SD_M,
    ) -> None:
        refuse_text(elevation_m=elevation_m, position_sd_m=position_sd_m)
        if not 0.0 < position_sd_m <= _SEARCH.most_position_sd_m:
            raise InputError(
                f"the standard deviation of the position is {position_sd_m:g} m; expected above "
                f"0, at most {_SEARCH.most_position_sd_m:g}: search a wider area with skyline match"
            )
        self.terrain = read_dem(dem)
        self.curvature = self.terrain.frame.curvature
        self.frame = self.terrain.frame
        self._position_sd_m = position_sd_m
        ground = stand_at_one(self.terrain, lon=lon, lat=lat, eye_height_m=0.0)
        self._east, self._north = float(ground.easting_m[0]), float(ground.northing_m[0])
        self._ground_m = float(ground.eye_elevation_m[0])
        self._elevation_m = elevation_m
        if elevation_m is not None:
            lowest_m = self._around(position_sd_m).eye_elevation_m.min() - DEFAULT_EYE_HEIGHT_M
            check_eye_elevation(elevation_m, float(lowest_m))
        views = RenderConfig(VIEW_WIDTH, curvature=self.curvature)
        self._scene = RenderedScene(self.terrain, views)
        # Kept, since it holds the terrain's textures, which the scene shares.
        self._panoramas = PanoramaRenderer(self.terrain, BINS, self.curvature)
        self._retriever = self._retriever_at(elevation_m)
        self._model = confidence.models("orientation.json")[confidence.ORIENTED]

    def __repr__(self) -> str:
        lon, lat = self.frame.to_lonlat(self._east, self._north)
        return f"Orienter(lon {lon:.5f}, lat {lat:.5f}, {self.terrain})"

    def _around(self, away_m: float) -> Viewpoints:
        """Return eyes at the known place and on a ring around it."""
        ring = away_m * np.exp(2j * np.pi * np.arange(_SEARCH.ring) / _SEARCH.ring)
        around = complex(self._east, self._north) + np.concatenate([[0.0], ring])
        return stand_where_possible(self.terrain, around.real, around.imag)[0]

    def _retriever_at(self, elevation_m: float | None) -> Retriever:
        """Return a retriever of poses for eyes at an elevation.

        For None, and where the ground is higher, the eyes stand on the ground.
        """
        eyes = self._around(self._position_sd_m)
        if elevation_m is not None:
            np.maximum(eyes.eye_elevation_m, elevation_m, out=eyes.eye_elevation_m)
        places = Places.of(self._panoramas.render(eyes), self._position_sd_m / 2.0)
        return Retriever(JoinedShards([[LocalShard(places, self._scene.ground_m)]]))

    def _standings(self, noted: NotedPlace) -> list[Standing]:
        """Return the ways of standing at the known place."""
        height_sd_m = self._scene.height_sd_m
        if self._elevation_m is not None:
            above_m = max(DEFAULT_EYE_HEIGHT_M, self._elevation_m - self._ground_m)
            return [Standing(EyeHeightPrior(above_m, height_sd_m), self._elevation_m)]
        reliefs_m = self._relief_m(self._position_sd_m), self._relief_m(_SEARCH.takeoff_m)
        ground = KnownGround(self._ground_m, *reliefs_m, height_sd_m)
        return Standing.of_noted(noted, ground)

    def _relief_m(self, away_m: float) -> float:
        """Return how far the ground's heights deviate from the place's, rms.

        The ground is taken at the place and on a ring ``away_m`` around it.
        """
        ground_m = self._around(away_m).eye_elevation_m - DEFAULT_EYE_HEIGHT_M
        return math.sqrt(np.mean((ground_m - self._ground_m) ** 2))

    def close(self) -> None:
        """Free the orienter's GPU memory."""
        self._scene.close()
        self._panoramas.close()

    @one_blas_thread()
    def orient(
        self,
        photo: Picture | PhotoSkyline,
        fov_deg: float | None = None,
        name: str = "",
        heading_deg: tuple[float, float] | None = None,
    ) -> Orientation:
        """Find how the camera of a photo was held.

        The photo may be a sky mask, a trace or a skyline. The compass direction that a photo notes
        counts as a hint.

        Parameters
        ----------
        photo : path, PIL image, (H, W, 3) uint8 or PhotoSkyline
        fov_deg : float, optional
            Horizontal field of view; by default the photo's own, and one of 25 to 100 degrees if
            that is not known.
        name : str
            Name of the result; by default the photo's file.
        heading_deg : (float, float), optional
            Heading of the optical axis from true north, and its greatest error, degrees. No other
            heading is found.

        Raises
        ------
        InputError
            The photo has no usable skyline, is a panorama or a fisheye of unknown field of view, or
            the greatest error is not above 0 and at most 180.
        """
        narrowing = Narrowing(heading_deg=heading_deg)
        started = time.perf_counter()
        file, skyline = named_skyline(photo, fov_deg)
        found = self._oriented(skyline, narrowing)
        if found.confidence < _DOUBTS.sure or found.refusal is not None:
            # What hides in haze may be the skyline that the terrain model has.
            farther = [self._oriented(one, narrowing) for one in farther_skylines(skyline)]
            found = _surest([found, *farther])
        return replace(found, seconds=time.perf_counter() - started, name=name or file)

    def _oriented(self, skyline: PhotoSkyline, narrowing: Narrowing) -> Orientation:
        """Return how the camera that saw a skyline was held."""
        refusal = too_little(skyline)
        if refusal is not None:
            return Orientation(skyline, None, refusal=refusal)
        rays = Rays.of(skyline, ASSUMED.fov_sd_share, finds_fov=True)
        poses = self._refined(rays, skyline, narrowing)
        return self._orientation(skyline, rays, poses, narrowing)

    def _refined(self, rays: Rays, skyline: PhotoSkyline, narrowing: Narrowing) -> Poses:
        """Return the best pose of each heading in each standing, best first.

        The headings are those that the narrowing allows.
        """
        found = list[Poses]()
        for number, standing in enumerate(self._standings(skyline.noted)):
            # The first standing is the one for which the retriever was made.
            retriever = self._retriever if number == 0 else self._retriever_at(standing.elevation_m)
            prior = self._prior(skyline.noted, standing, narrowing)
            fitted = retriever.fitted_all_round(rays)
            fitted = fitted[prior.allows(fitted)]
            each = fitted.suppress_non_maxima(_SEARCH.headings, np.inf, _SEARCH.turn_deg)
            best = fitted.suppress_non_maxima(
                _SEARCH.places, _SEARCH.separation_m, _SEARCH.turn_deg
            )
            refinement = self._refinement(rays, prior, standing)
            poses = refinement.run(fitted[np.union1d(each, best)])
            poses = replace(poses, cost=poses.cost + TEMPERATURE * standing.cost)
            found.append(poses[prior.allows(poses)])
        poses = Poses.concatenate(found)
        return poses[np.argsort(poses.cost, kind="stable")]

    def _prior(self, noted: NotedPlace, standing: Standing, narrowing: Narrowing) -> Prior:
        """Return a pose's prior: the known place, and the direction noted."""
        known = PositionPrior(
            self._east,
            self._north,
            self._position_sd_m,
            elevation_m=standing.elevation_m,
            elevation_scale_m=standing.elevation_scale_m,
        )
        # The photo need not note a position: the heading is turned at the known one.
        return Prior(narrowing, self.frame, position=known.looking_as(noted, self.frame))

    def _refinement(self, rays: Rays, prior: Prior, standing: Standing) -> _RefinementByHeading:
        """Return the refinement of a photo's rays, with its prior."""
        return _RefinementByHeading(rays, self._scene, _EFFORT, prior, standing.eye)

    def _orientation(
        self, skyline: PhotoSkyline, rays: Rays, poses: Poses, narrowing: Narrowing
    ) -> Orientation:
        """Return the best pose as an orientation, refused if doubtful."""
        if not len(poses):
            return Orientation(skyline, None, refusal=_nothing_fits(narrowing))
        other_eye = self._other_eye(poses)
        poses = poses[poses.suppress_non_maxima(len(poses), np.inf, _SEARCH.apart_deg)]
        moved_m = self._moved_m(poses)
        figures = confidence.oriented_figures(poses, rays, moved_m)
        sure = float(self._model.probability(figures)[0])
        pose = replace(poses[:1].on_map(self.frame)[0], rank=None)
        above_m = float(self._eye_heights_m(poses[:1])[0])
        # The other projections are fitted to an eye that stands as the pose's does.
        standing = Standing(EyeHeightPrior(above_m, self._scene.height_sd_m))
        prior = self._prior(skyline.noted, standing, narrowing)
        other = find_other_projection(
            rays, Poses.of(pose), sure, lambda bent: self._refinement(bent, prior, standing)
        )

        def refused(*doubts: str | None) -> str | None:
            return refusal_of(pose, skyline, rays, doubts=doubts, ambiguity=other_eye, other=other)

        unsure = self._unsure(poses, pose, sure)
        too_far = self._too_far(moved_m[0])
        names = (f"{name}_sd_deg" for name in ANGLES)
        errors_deg = dict(zip(names, poses.figures().angle_sd_deg[0].tolist(), strict=True))
        return Orientation(
            skyline,
            pose,
            **errors_deg,
            confidence=sure,
            moved_m=float(moved_m[0]),
            eye_height_m=above_m,
            refusal=refused(unsure, too_far),
            lacks_confidence_only=unsure is not None and refused(too_far) is None,
        )

    def _other_eye(self, poses: Poses) -> str | None:
        """Return the refusal where an eye at another height fits as well.

        None if no other eye does.
        """
        heights_m = self._eye_heights_m(poses)
        is_same = (
            angle_between_deg(poses.grid_heading_deg, poses.grid_heading_deg[0]) < _SEARCH.apart_deg
        )
        off_m = np.abs(poses.eye_elevation_m - poses.eye_elevation_m[0])
        same_m = max(_DOUBTS.eye_sds * self._scene.height_sd_m, _DOUBTS.eye_share * heights_m[0])
        is_other = is_same & (off_m > same_m)
        is_close = poses.cost - poses.cost[0] < _DOUBTS.eye_cost
        rivals = np.flatnonzero(is_other & is_close)
        if not len(rivals):
            return None
        return (
            f"the eye may stand {heights_m[0]:.0f} m above the ground, or "
            f"{heights_m[rivals[0]]:.0f} m, as the photo notes a height; give its elevation "
            "with --elevation"
        )

    def _eye_heights_m(self, poses: Poses) -> Float64Array:
        """Return the heights (M,) of eyes above the ground."""
        ground_m = self._scene.ground_m(poses.easting_m, poses.northing_m)
        return np.asarray(poses.eye_elevation_m - ground_m)

    def _moved_m(self, poses: Poses) -> Float64Array:
        """Return how far poses (M,) lie from the known place."""
        return np.abs(poses.position_m - complex(self._east, self._north))

    def _too_far(self, moved_m: float) -> str | None:
        """Return the refusal of a pose far from the place, or None."""
        if moved_m <= _DOUBTS.far_sds * self._position_sd_m:
            return None
        return (
            f"the best pose is {moved_m:.0f} m from the place, whose standard "
            f"deviation is {self._position_sd_m:g} m; check the place"
        )

    def _unsure(self, poses: Poses, pose: Pose, sure: float) -> str | None:
        """Return the refusal of an unsure heading with a hint, or None."""
        if sure >= LEAST_CONFIDENCE:
            return None
        doubt = _too_unsure(sure)
        cost = poses.cost
        if len(poses) > 1 and cost[1] - cost[0] < _DOUBTS.named_cost:
            other_deg = (poses.grid_heading_deg[1] + pose.convergence_deg) % 360.0
            return f"{doubt}; a heading of {other_deg:.0f} degrees fits about as well"
        return f"{doubt}; {pose.residual_in_words}"


def _surest(orientations: Sequence[Orientation]) -> Orientation:
    """Return the surest of the orientations by a photo's several skylines.

    At most one of the skylines is the terrain's, so other headings are rivals.
    """
    surest = max(orientations, key=lambda found: found.confidence)
    best = surest.pose
    rivals = [
        (found.confidence, found.pose.heading_deg)
        for found in orientations
        if best and found.pose and found.pose.turn_deg(best) > _SEARCH.apart_deg
    ]
    if not rivals:
        return surest
    sure = confidence.beside_rivals(surest.confidence, (one for one, _ in rivals))
    surest = replace(surest, confidence=sure)
    if surest.answer is None or sure >= LEAST_CONFIDENCE:
        return surest
    _, heading_deg = max(rivals)
    return replace(
        surest,
        refusal=f"{_too_unsure(sure)}; a heading of {heading_deg:.0f} degrees fits another skyline "
        "that the photo may have",
        lacks_confidence_only=True,
    )


def _nothing_fits(narrowing: Narrowing) -> str:
    """Return the refusal of a photo that no heading fits."""
    within = ""
    if narrowing.heading_deg is not None:
        heading_deg, slack_deg = narrowing.heading_deg
        within = f" within {slack_deg:g} degrees of {heading_deg:g}"
    return f"no heading{within} fits at this place"


def _too_unsure(sure: float) -> str:
    """Return the refusal of a heading with too little confidence."""
    return (
        f"the heading has a confidence of {confidence_in_words(sure)}, and "
        f"{LEAST_CONFIDENCE:.2f} is needed"
    )


@contextmanager
def orienters(terrain: HeightField) -> Iterator[Callable[[KnownPosition], Orienter]]:
    """Yield a function that returns a position's orienter.

    The orienter is reused as long as the position stays the same, as for the frames of a fixed
    camera. It is closed only after the next one is made, so that both share the terrain's textures;
    the last is closed at the end of the block.
    """
    made: dict[KnownPosition, Orienter] = {}

    def orienter_at(position: KnownPosition) -> Orienter:
        if position not in made:
            made[position] = Orienter(terrain, **position._asdict())
            while len(made) > 1:
                made.pop(next(iter(made))).close()
        return made[position]

    try:
        yield orienter_at
    finally:
        for one in made.values():
            one.close()


class _RefinementByHeading(Refinement):
    """A refinement at one place, whose rivals are other headings."""

    def survivors(self, particles: Particles, count: int) -> Particles:
        """Return the next round's particles: the best, and each heading's best."""
        ordered = particles.best(len(particles))
        poses = self.poses(ordered)
        rivals = poses.suppress_non_maxima(_SEARCH.rivals, np.inf, _SEARCH.apart_deg)
        return ordered[np.union1d(np.arange(min(count, len(ordered))), rivals)]

    def distinct(self, particles: Particles, count: int) -> Particles:
        """Return the best particle of each heading, best first."""
        poses = self.poses(particles)
        return particles[poses.suppress_non_maxima(count, np.inf, _SEARCH.apart_deg)]


def orient(  # noqa: PLR0913  (independent knowledge)
    photo: Picture | PhotoSkyline,
    dem: Dem,
    *,
    lon: float | None = None,
    lat: float | None = None,
    elevation_m: float | None = None,
    position_sd_m: float | None = None,
    fov_deg: float | None = None,
    heading_deg: tuple[float, float] | None = None,
) -> Orientation:
    """Find how a photo's camera was held at a known place.

    See `Orienter` and `Orienter.orient`. Without ``lon`` and ``lat`` the photo's own GPS position
    is the place, with the standard deviation that the photo notes.

    Raises
    ------
    InputError
        There is no position, in the photo or as given, or only half of one; or as
        `Orienter.orient`.
    OffMapError
        The place is off the map or on a hole.
    """
    if (lon is None) is not (lat is None):
        raise InputError(
            "one of lon and lat is given; give both, or neither to use the photo's GPS position"
        )
    name, skyline = named_skyline(photo, fov_deg)
    lonlat_deg = None if lon is None or lat is None else (lon, lat)
    position = known_position(skyline.noted, name, lonlat_deg, elevation_m, position_sd_m)
    with Orienter(dem, **position._asdict()) as orienter:
        return orienter.orient(skyline, name=name, heading_deg=heading_deg)


def known_position(
    noted: NotedPlace,
    name: str,
    lonlat_deg: tuple[float, float] | None,
    elevation_m: float | None,
    position_sd_m: float | None,
) -> KnownPosition:
    """Return the position given, or else the one that a photo notes.

    Raises `InputError` for a photo without a position.
    """
    usual_m = DEFAULT_POSITION_SD_M
    if lonlat_deg is None:
        lonlat_deg, usual_m = noted.lonlat_deg, noted_position_scale_m(noted)
    if lonlat_deg is None:
        aside = f" ({noted.left_aside})" if noted.left_aside else ""
        raise InputError(
            f"{printable(name)} notes no GPS position{aside}; give the place: --at LON,LAT"
        )
    return KnownPosition(
        *lonlat_deg, elevation_m, usual_m if position_sd_m is None else position_sd_m
    )
