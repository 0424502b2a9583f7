"""`Matcher`: matches photos to a store, and to the store's terrain."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from PIL.Image import Image
from pyproj import CRS

from skyline.errors import InputError
from skyline.geodesy.map_frame import Frame
from skyline.match.areas import MatchedArea, frame_of, paths_of, terrain_at_hand
from skyline.match.confidence import beside_rivals
from skyline.match.config import MatchConfig
from skyline.match.contours import weighed_by_contours
from skyline.match.joint_result import JointResult
from skyline.match.method import MATCHERS, SearchMethod
from skyline.match.narrowing import Narrowing
from skyline.match.other_projection import OtherProjection
from skyline.match.posterior import Findings, Posterior, grid_around, posterior_of
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.rays import Rays
from skyline.match.refine import VIEW_WIDTH
from skyline.match.result import TOP, MatchResult
from skyline.match.shard import Shard
from skyline.match.verdict import Verdict, candidate_reached, too_little
from skyline.match.walk import check_walk, of_walk
from skyline.photo.haze import farther_skylines
from skyline.photo.image import Picture
from skyline.photo.read import named_skyline
from skyline.photo.skyline import PhotoSkyline
from skyline.plugins import load
from skyline.pose.pose import ROUGHLY_WITHIN_M, Pose
from skyline.pose.poses import Poses
from skyline.progress import Progress, StepProgress, silent
from skyline.render.context import Closeable, RenderThread
from skyline.render.horizon import RenderConfig, RenderedScene
from skyline.store.layout import StoreHeader
from skyline.store.merge import by_model, open_joined
from skyline.terrain.dem import Dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.surface_model import read_surface
from skyline.terrain.viewpoints import Viewpoints

T = TypeVar("T")

_DISAGREES = "the photo does not fit where the others were taken"
_ALONE = "no other photo shows enough skyline to be compared with it"
FULL = "full"


class Matcher(Closeable):
    """Matches skylines to a store, which is read once.

    Any thread may match. `close`, or the end of a ``with`` block, frees the memory on the GPU.

    Parameters
    ----------
    store : path or paths
        Several stores are searched without copying them. Stores of one DEM must have one
        configuration, and are searched as the store that `skyline.store.merge.merge_stores` would
        make of them. The full matcher also searches stores of several DEMs, in any frames, as one.
    dem : path, paths, DataArray or HeightField, optional
        The DEM that the store was rendered from; by default it is read from the files that the
        store names, and for stores of several DEMs it must be. The full matcher takes heights from
        it, and renders it for refinement. If it cannot be read, a warning is logged and answers
        stay unrefined.
    matcher : str
        ``full``, which searches a store of places; ``paper`` or ``correlation``, which search a
        store of renderings; or the name of another package's, see `SearchMethod`.
    config : MatchConfig, optional
        Settings of the search, and the least confidence of an answer.
    render_thread : RenderThread, optional
        A thread that renders, for programs that also render something more urgent, as a page does:
        what is urgent comes between the pieces of a match. Any thread may match, and several at a
        time, with or without a render thread.
    surface : path, paths, DataArray or HeightField, optional
        A surface or canopy model: the height to which trees and houses may rise above the DEM's
        skyline. The full matcher uses it in refinement.

    Raises
    ------
    InputError
        The matcher's name is unknown, the store is not of the kind that the matcher searches, the
        surface does not cover the DEM, or a surface is given to a matcher that does not refine. A
        DEM or a surface is given for stores of several DEMs, or the matcher cannot search these.
    StoreError
        The store cannot be read, or angles are wrong on its map.
    StoreMismatchError
        The store was rendered from another DEM, or stores of one DEM with other settings.
    """

    def __init__(
        self,
        store: str | Path | Sequence[str | Path],
        dem: Dem | None = None,
        matcher: str = FULL,
        config: MatchConfig | None = None,
        render_thread: RenderThread | None = None,
        surface: Dem | None = None,
    ) -> None:
        method: type[SearchMethod] = load(MATCHERS, matcher)
        self._config = MatchConfig() if config is None else _instance("config", config, MatchConfig)
        if surface is not None and not (method.renders and self._config.refine):
            raise InputError("a surface is used in refinement; use the full matcher, and refine")
        self.render_thread = render_thread
        groups = by_model(paths_of(store))
        if len(groups) > 1 and not (dem is None and surface is None):
            raise InputError(
                f"the stores are of {len(groups)} elevation models, which are read from the files "
                "that they name; leave the DEM and the surface out"
            )
        self._scenes: list[RenderedScene] = []
        try:
            opened = [self._opened(method, group, dem, surface) for group in groups]
            self.areas = tuple(area for area, _ in opened)
            if any(area.frame.lonlat_crs != self.crs for area in self.areas):
                raise InputError("the stores are of several worlds; name stores of one")
        except BaseException:
            self.close()
            raise
        if len(self._scenes) < len(groups):
            # Costs of refined poses do not compare with costs of others: all are refined, or none.
            self.close()
        self.rows = sum(area.rows for area in self.areas)
        self.holds = method.holds
        methods = [one for _, one in opened]
        self._method = methods[0] if len(methods) == 1 else method.joined(methods)

    def _opened(
        self,
        method: type[SearchMethod],
        stores: Sequence[str | Path],
        dem: Dem | None,
        surface: Dem | None,
    ) -> tuple[MatchedArea, SearchMethod]:
        """Open the stores of one DEM; raises as the constructor."""
        with open_joined(stores) as file:
            header = file.header
            if not len(file):
                raise InputError(f"store {file.path} holds no {header.holds}; build it first")
            file.expect(method.holds)
            frame = frame_of(file)
            terrain = None if dem is None else header.read_dem(dem)
            if method.renders and terrain is None:
                terrain = terrain_at_hand(header, "answers unrefined")
            if surface is not None and terrain is None:
                raise InputError("a surface needs the store's DEM, which is not at hand; give it")
            scene = None
            if method.renders and self._config.refine and terrain is not None:
                over = None if surface is None else read_surface(surface, terrain)
                rendering = RenderConfig(VIEW_WIDTH, curvature=header.curvature)
                scene = RenderedScene(terrain, rendering, self.render_thread, over)
                self._scenes.append(scene)
            area = MatchedArea(header, frame, terrain, len(file))
            return area, method.open(file, terrain, scene)

    @property
    def header(self) -> StoreHeader:
        """The header of the store; raises as `only_area`."""
        return self.only_area().header

    @property
    def frame(self) -> Frame:
        """The frame of the store; raises as `only_area`."""
        return self.only_area().frame

    @property
    def crs(self) -> CRS:
        """The CRS of the results' longitudes and latitudes."""
        return self.areas[0].frame.lonlat_crs

    @property
    def terrain(self) -> HeightField | None:
        """The store's terrain, if it can be read; raises as `only_area`."""
        return self.only_area().terrain

    def search_by(self, shards: Sequence[Sequence[Shard]], at_once: int) -> None:
        """Search each area's places by shards, such as those of `skyline.match.distant_shards`.

        ``at_once`` shards are asked at a time.
        """
        self._method = self._method.by_shards(shards, at_once)

    def only_area(self) -> MatchedArea:
        """Return the one area searched; raises `InputError` if there are several."""
        if len(self.areas) > 1:
            raise InputError(
                f"the stores are of {len(self.areas)} elevation models, and this needs one: name "
                "stores of one"
            )
        return self.areas[0]

    @staticmethod
    def too_little(skyline: PhotoSkyline) -> str | None:
        """Return the refusal of a skyline of too few degrees, or None."""
        return too_little(skyline)

    @cached_property
    def viewpoints(self) -> Viewpoints:
        """The store's eyes, evenly thinned if very many; raises as `only_area`."""
        self.only_area()
        return self._method.eyes()

    def __repr__(self) -> str:
        refined = "answers refined" if self._scenes else "answers not refined"
        return f"Matcher({self.rows} {self.holds}, {refined})"

    def close(self) -> None:
        """Free the matcher's GPU memory; it cannot refine after that."""
        for scene in self._scenes:
            scene.close()
        self._scenes.clear()

    def match(
        self,
        photo: Picture | PhotoSkyline,
        fov_deg: float | None = None,
        top: int = TOP,
        narrowing: Narrowing | None = None,
        report_progress: StepProgress = silent,
    ) -> MatchResult:
        """Find where a photo was taken, or its mask, trace or skyline.

        Parameters
        ----------
        photo : path, PIL image, (H, W, 3) uint8 or PhotoSkyline
        fov_deg : float, optional
            Horizontal field of view, degrees; by default the photo's own.
        top : int
            Most candidates to return; the candidates themselves do not depend on it.
        narrowing : Narrowing, optional
            Knowledge about the photo's pose; only the full matcher takes any.
        report_progress : callable, optional
            Called, in this thread, with the current `skyline.progress.Step` and the share of it
            that is done, 0 to 1. An exception that it raises ends the match.

        Returns
        -------
        MatchResult
            Its ``answer`` is the `Pose` with ``lon``, ``lat`` and ``heading_deg`` of the
            camera, or None with the reason in ``refusal``; ``candidates`` are all places that fit,
            best first. ``to_dict()`` and ``to_dataframe()`` give them as records and as a table.

        Raises
        ------
        InputError
            The photo has no usable skyline, its field of view is unknown and the matcher needs one,
            the search is narrowed to no place, or ``top`` is below 1.
        StoreError
            The store was damaged or cut short since it was opened.
        """
        started = time.perf_counter()
        _check_top(top)
        name, skyline = named_skyline(photo, fov_deg)
        found = self._found(skyline, top, narrowing, report_progress)
        verdict = self._verdict(found)
        if verdict.refusal is not None and self._method.renders:
            # What hides in haze may be the skyline that the terrain model has.
            farther = [
                self._found(one, top, narrowing, report_progress)
                for one in farther_skylines(skyline)
            ]
            if farther:
                found = _surest([found, *farther])
                verdict = self._verdict(found)
        return MatchResult(
            replace(found.skyline, picture=None),
            found.candidates,
            time.perf_counter() - started,
            verdict.refusal,
            verdict.within_m,
            name,
            narrowing=narrowing or Narrowing(),
            crs=self.crs,
        )

    def _found(
        self,
        skyline: PhotoSkyline,
        top: int,
        narrowing: Narrowing | None,
        report_progress: StepProgress,
    ) -> _Search:
        """Search for one skyline of a photo; raises as `match`."""
        asked = self._asked(skyline, narrowing)
        if asked.known is None:
            return asked
        poses = self._method.search(*asked.known, max(top, TOP), report_progress)
        candidates = self._weighed(self._on_map(poses), skyline)[:top]
        return replace(asked, candidates=candidates)

    def _asked(self, skyline: PhotoSkyline, narrowing: Narrowing | None, name: str = "") -> _Search:
        """Return a skyline to search for, without candidates yet."""
        refusal = too_little(skyline)
        known = None if refusal else self._rays_and_prior(skyline, narrowing)
        return _Search(skyline, name, refusal, known)

    def _verdict(self, found: _Search) -> Verdict:
        """Return whether the best candidate is the answer."""
        if found.known is None:
            return Verdict(found.refusal)
        rays, _ = found.known
        other = self._other_projection(found)
        return Verdict.of_search(found.candidates, other, self._config, found.skyline, rays)

    def _other_projection(self, found: _Search) -> OtherProjection | None:
        """Return the likeliest other projection of a photo by its best candidate."""
        if found.known is None or found.best is None:
            return None
        rays, prior = found.known
        return self._method.other_projection(rays, found.best, prior)

    def _weighed(self, candidates: tuple[Pose, ...], skyline: PhotoSkyline) -> tuple[Pose, ...]:
        """Return the candidates, weighed by what a photo shows below its skyline."""
        if not candidates:
            return candidates
        area = self.areas[candidates[0].area]
        if area.terrain is None:
            return candidates
        return weighed_by_contours(candidates, skyline, area.terrain, area.header.curvature)

    def _on_map(self, poses: Poses) -> tuple[Pose, ...]:
        return poses.on_map(*(area.frame for area in self.areas))

    def match_together(
        self,
        photos: Sequence[Picture | PhotoSkyline],
        fov_deg: float | None = None,
        top: int = TOP,
        narrowings: Sequence[Narrowing | None] | None = None,
        report_progress: StepProgress = silent,
    ) -> JointResult:
        """Find the one place where several photos were taken.

        Photos that look in different directions together hold more information than each one. A
        photo that was taken at another place seldom spoils the answer; the result names it if it
        fits nowhere near the place of the others.

        Parameters
        ----------
        photos : sequence of path, PIL image, array or PhotoSkyline
            Two or more.
        fov_deg, top, report_progress
            See `match`.
        narrowings : sequence of Narrowing or None, optional
            Knowledge about the pose of each photo.

        Returns
        -------
        JointResult
            Its ``answer`` is the place, ``results`` has a `MatchResult` for each photo.

        Raises
        ------
        InputError
            There are fewer than two photos, the matcher does not render, or as in `match`.
        StoreError
            See `match`.
        """
        started = time.perf_counter()
        _check_top(top)
        found = self._found_together(self._read(photos, fov_deg, narrowings), top, report_progress)
        agreeing = [one for one in found if one.candidates]
        others = ((one.name, self._other_projection(one)) for one in agreeing)
        candidates = [one.candidates for one in agreeing]
        verdict = Verdict.of_joint_search(candidates, others, self._config)
        seconds = time.perf_counter() - started
        usable = sum(one.known is not None for one in found)
        apart = _DISAGREES if usable > 1 else _ALONE
        results = []
        for one in found:
            own = verdict if one.candidates else Verdict(one.refusal or apart)
            results.append(
                MatchResult(
                    one.skyline,
                    one.candidates,
                    seconds,
                    own.refusal,
                    own.within_m,
                    one.name,
                    crs=self.crs,
                )
            )
        given = tuple(narrowing or Narrowing() for narrowing in narrowings or [None] * len(found))
        return JointResult(tuple(results), seconds, verdict.refusal, given)

    def posterior(
        self, result: MatchResult | JointResult, report_progress: StepProgress = silent
    ) -> Posterior:
        """Return the probability that a photo was taken at each place.

        The map covers the searched area, whether or not there is an answer. The photo's
        skyline is compared with the whole store once more.

        Parameters
        ----------
        result : MatchResult or JointResult
            What `match` returned for the photo, or `match_together` for photos of one place.
        report_progress : callable, optional
            See `match`.

        Raises
        ------
        InputError
            The matcher is not the full one, or the result is not from a search.
        StoreError
            See `match`.
        """
        frame = self.only_area().frame
        return posterior_of(self._findings(result, report_progress), frame)

    def joined_posteriors(
        self,
        results: Sequence[MatchResult | JointResult],
        times: Sequence[datetime],
        walked_km_h: float,
        progress: Progress | None = None,
    ) -> list[Posterior]:
        """Return the posterior of each photo of a walk, from all photos.

        One person took the photos, and went from each to the next at ``walked_km_h`` at most, as
        the crow flies. All posteriors are on one grid.

        Parameters
        ----------
        results : sequence of MatchResult or JointResult
            As `posterior` takes, in any order.
        times : sequence of datetime
            When each photo was taken, all by one clock: all with a zone, or none.
        walked_km_h : float
            Greatest speed, kilometres per hour.
        progress : callable, optional
            Called with the number of photos that are done, and the number of all photos.

        Raises
        ------
        InputError
            As `posterior`; there is no photo, or not a time for each; the speed is not above 0; or
            no such walk is possible.
        StoreError
            See `match`.
        """
        check_walk(len(results), times, walked_km_h)
        frame = self.only_area().frame
        found = []
        for done, result in enumerate(results):
            if progress is not None:
                progress(done, len(results))
            found.append(self._findings(result, silent))
        grid = grid_around(found)
        alone = [posterior_of(one, frame, grid) for one in found]
        return of_walk(alone, times, walked_km_h)

    def _findings(
        self, result: MatchResult | JointResult, report_progress: StepProgress
    ) -> Findings:
        """Compare all places with the photos of a result once more."""
        photos = _searched(result)
        known = [self._rays_and_prior(skyline, narrowing) for skyline, narrowing in photos]
        fitted, places = self._method.likely_places(known, report_progress)
        priors = [prior for _, prior in known]
        noted = (prior for prior in priors if prior.position is not None)
        return Findings(result.candidates, fitted, places, next(noted, priors[0]))

    def _read(
        self,
        photos: Sequence[Picture | PhotoSkyline],
        fov_deg: float | None,
        narrowings: Sequence[Narrowing | None] | None,
    ) -> list[_Search]:
        """Return the photos of one place; raises `InputError` for fewer than two."""
        if isinstance(photos, str | Path | PhotoSkyline | Image):
            photos = [photos]
        given = list(photos)
        if narrowings is None:
            narrowings = [None] * len(given)
        if len(given) < 2:
            raise InputError(
                f"{len(given)} photos of one place; expected two photos or more, or `match` for one"
            )
        if len(narrowings) != len(given):
            raise InputError(
                f"{len(given)} photos and {len(narrowings)} narrowings; expected as many"
            )
        named = [named_skyline(photo, fov_deg) for photo in given]
        return [
            self._asked(replace(skyline, picture=None), narrowing, name)
            for (name, skyline), narrowing in zip(named, narrowings, strict=True)
        ]

    def _found_together(
        self, photos: Sequence[_Search], top: int, report: StepProgress
    ) -> list[_Search]:
        """Return the photos; those that agree have their common candidates."""
        usable = {
            number: photo.known for number, photo in enumerate(photos) if photo.known is not None
        }
        found = list(photos)
        if len(usable) < 2:
            return found
        self.only_area()
        together, agrees = self._method.search_together(list(usable.values()), top, report)
        for number, poses, belongs in zip(usable, together, agrees, strict=True):
            if belongs:
                found[number] = replace(photos[number], candidates=self._on_map(poses))
        return found

    def fit(
        self,
        photo: PhotoSkyline | MatchResult,
        start: Pose,
        narrowing: Narrowing | None = None,
    ) -> MatchResult:
        """Refine a pose by rendering, as a search does.

        A fit that leads to one of the search's candidates is that candidate, with the search's
        verdict. A fit that leads to the same answer but fits better than the candidate replaces it:
        its pose gets the candidate's rank and confidences.

        Elsewhere, and without a search, the result's one candidate has no rank and no confidence,
        since no other place was tried. The fit has failed, and there is no answer, if poses that
        fit as badly are seldom right, or if the answer of the search fits better; the candidate
        then has no covariance. There is no candidate where the pose does not fit at all.

        Parameters
        ----------
        photo : PhotoSkyline or MatchResult
            A skyline, or the result of `match` for it, which has its narrowing.
        start : Pose
            A pose at most some 100 m, 5 degrees of heading and a twentieth of the field of view
            from the true one.
        narrowing : Narrowing, optional
            Only its eye height, photo spots and use of GPS count; the place may lie anywhere.

        Raises
        ------
        InputError
            The matcher does not render, the pose is off the map, or the result is not from a
            search of one photo.
        """
        started = time.perf_counter()
        if isinstance(photo, MatchResult):
            if photo.narrowing is None or narrowing is not None:
                raise InputError("a fit takes a photo and a narrowing, or the result of `match`")
            searched = photo
            skyline = searched.skyline
            narrowing = searched.narrowing
        else:
            searched = None
            skyline = photo
        pose = self._fitted(skyline, start, narrowing)
        reached = candidate_reached(searched.candidates, start, pose) if searched else None
        if searched and reached:
            result = replace(searched.chosen(reached.rank or 1), candidates=(reached,))
        else:
            answer = searched.answer if searched else None
            refusal = Verdict.of_fit(pose, answer, self._config).refusal
            candidates = () if pose is None else (_without_search(pose, refusal),)
            result = MatchResult(skyline, candidates, 0.0, refusal, crs=self.crs)
        return replace(result, seconds=time.perf_counter() - started, narrowing=None)

    def _fitted(
        self, skyline: PhotoSkyline, start: Pose, narrowing: Narrowing | None
    ) -> Pose | None:
        """Return the pose to which a start leads, or None."""
        about_start = skyline.with_fov(start.fov_deg)
        if skyline.projection.spreads_angles and skyline.fov_deg is None:
            skyline = about_start  # No search finds a panorama's or a fisheye's field of view.
        rays, prior = self._rays_and_prior(skyline, narrowing)
        poses = self._method.fitted(rays, start, prior, self._rays(about_start))
        return next(iter(self._on_map(poses)), None)

    def _rays(self, skyline: PhotoSkyline) -> Rays:
        """Return a photo's rays; raises `InputError` if the matcher needs its lens."""
        return Rays.of(skyline, self._config.fov_sd_share, finds_fov=self._method.finds_fov)

    def _rays_and_prior(
        self, skyline: PhotoSkyline, narrowing: Narrowing | None
    ) -> tuple[Rays, Prior]:
        """Return a photo's rays and prior.

        Raises `InputError` for a narrowing if the matcher takes no prior.
        """
        narrowing = _instance("narrowing", narrowing or Narrowing(), Narrowing)
        rays = self._rays(skyline)
        if not self._method.takes_prior:
            if narrowing != Narrowing():
                raise InputError(
                    "this matcher cannot narrow its search; use the full one, or leave it wide"
                )
            return rays, NOTHING_KNOWN
        if narrowing.eye_height_m is None:
            narrowing = replace(narrowing, eye_height_m=skyline.eye_height_m)
        noted = skyline.noted if narrowing.use_gps else None
        return rays, Prior.of(narrowing, self.areas[0].frame, noted)


def _searched(result: MatchResult | JointResult) -> list[tuple[PhotoSkyline, Narrowing]]:
    """Return the skylines and narrowings of a search.

    For photos of one place, only those that agree are returned, or all if none does. Raises
    `InputError` for a result that is not from a search.
    """
    if isinstance(result, MatchResult) and result.narrowing is not None:
        return [(result.skyline, result.narrowing)]
    if not isinstance(result, JointResult):
        raise InputError(
            "a posterior takes the result of `match` or of `match_together`, one at a time"
        )
    photos = [
        (one.skyline, narrowing)
        for one, narrowing in zip(result.results, result.narrowings, strict=True)
    ]
    agreeing = [photo for photo, agrees in zip(photos, result.agrees, strict=True) if agrees]
    return agreeing or photos


def _without_search(pose: Pose, refusal: str | None) -> Pose:
    """Return a fitted pose without a rank and confidences.

    No other place was tried. A refused pose has no covariance either: the errors of a wrong fit
    mean nothing.
    """
    if refusal:
        pose = replace(pose, covariance_m2=None, covariance=None)
    return replace(pose, rank=None, confidence=None, confidence_1km=None)


@dataclass(frozen=True, slots=True)
class _Search:
    """One skyline of a photo, and the candidates found for it."""

    skyline: PhotoSkyline
    name: str
    """The photo's file; empty for pixels and for a skyline."""
    refusal: str | None
    """Why it cannot be searched for; None if it can."""
    known: tuple[Rays, Prior] | None
    """Its rays and the prior of its pose; None if it cannot be searched for."""
    candidates: tuple[Pose, ...] = ()

    @property
    def best(self) -> Pose | None:
        """The best candidate, if any."""
        return self.candidates[0] if self.candidates else None

    @property
    def confidence(self) -> float:
        """The best candidate's confidence within 1 km; 0 if not known."""
        return 0.0 if self.best is None else self.best.confidence_1km or 0.0


def _surest(searches: Sequence[_Search]) -> _Search:
    """Return the surest of the searches for several skylines of a photo.

    At most one of the skylines is the terrain's. So the best candidates of the others are rivals of
    the surest one, unless they are near it.
    """
    surest = max(searches, key=lambda found: found.confidence)
    if surest.best is None or not surest.confidence:
        return surest
    rivals = [
        found.confidence
        for found in searches
        if found.best and not found.best.is_same_answer(surest.best, ROUGHLY_WITHIN_M)
    ]
    factor = beside_rivals(surest.confidence, rivals) / surest.confidence
    return replace(surest, candidates=tuple(one.times_as_sure(factor) for one in surest.candidates))


def _check_top(top: int) -> None:
    if not isinstance(top, int | np.integer) or top < 1:
        raise InputError(f"top is {top!r}; expected a whole number of candidates from 1")


def _instance(name: str, value: object, kind: type[T]) -> T:
    if not isinstance(value, kind):
        raise InputError(f"{name} is {value!r}; expected a {kind.__name__}")
    return value
