"""Matches on the page: each runs in a thread, tells how far it has come, and can be ended."""

import threading
from collections.abc import Mapping
from typing import Any

from skyline import Candidate, MatchResult, Narrowing, QuerySkyline, SkylineError
from skyline.web.engine import Engine
from skyline.web.photos import PagePhoto, version_of

_STEPS = {"screening": (0.0, 0.25), "fitting": (0.25, 0.5), "refining": (0.5, 1.0)}
"""Where each step of a match begins and ends, as shares of all of it."""


class _CancelledError(Exception):
    """Somebody has ended the match."""


class Match:
    """One match of one photo; its result comes with the question ``asked``, as the page put it."""

    def __init__(
        self,
        photo: PagePhoto,
        query: QuerySkyline,
        narrowing: Narrowing,
        asked: Mapping[str, Any] | None = None,
    ) -> None:
        self.photo = photo
        self._query, self._narrowing = query, narrowing
        self._question = {"asked": asked, "skyline": version_of(query)}
        self._cancelled = threading.Event()
        self.step, self.share = "waiting", 0.0
        self.error: str | None = None
        self.done = False

    def cancel(self) -> None:
        """End the match at its next step; it leaves no result."""
        self._cancelled.set()

    def run(self, engine: Engine) -> None:
        """Match; the photo has the result, or this the error, when it is done."""
        try:
            self._check()
            result = engine.matcher.match(
                self._query, narrowing=self._narrowing, report_progress=self._report
            )
        except _CancelledError:
            self.error = "cancelled"
        except SkylineError as error:
            self.error = str(error)
        except MemoryError:
            self.error = "there is not enough memory for this match; narrow the search"
        else:
            self.photo.result = result
            self.photo.told = self._question | _outcome(result, engine)
            self.photo.state = "answered" if result.answer else "no answer"
        finally:
            if self.error is not None:
                self.photo.state = "ready"
            self.step, self.share, self.done = "done", 1.0, True

    def told(self) -> dict[str, Any]:
        """Return how far the match has come."""
        return {"photo": self.photo.id, "step": self.step, "share": self.share, "done": self.done}

    def _report(self, step: str, share: float) -> None:
        self._check()
        begins, ends = _STEPS.get(step, (0.0, 1.0))
        # A step may be taken twice, and a bar that runs back looks broken.
        self.share = max(self.share, begins + (ends - begins) * min(share, 1.0))
        self.step = step

    def _check(self) -> None:
        if self._cancelled.is_set():
            raise _CancelledError


def _outcome(result: MatchResult, engine: Engine) -> dict[str, Any]:
    """Return a result as the page shows it."""
    return {
        "candidates": [candidate_json(one, engine) for one in result.candidates],
        "answered": result.answer is not None,
        "within": result.within_m,
        "chance": result.confidence,
        "refusal": result.refusal,
        "claim": result.exif_in_words(),
        "beyond": result.beyond,
        "seconds": result.seconds,
    }


def candidate_json(candidate: Candidate, engine: Engine) -> dict[str, Any]:
    """Return a candidate as the page takes it."""
    return {
        "lon": candidate.lon,
        "lat": candidate.lat,
        "heading": candidate.heading_deg,
        "pitch": candidate.pitch_deg,
        "roll": candidate.roll_deg,
        "fov": candidate.fov_deg,
        "distortion": candidate.distortion,
        "elevation": candidate.eye_elevation_m,
        "eyeHeight": engine.eye_height_m(candidate),
        "confidence": candidate.confidence,
        "refined": candidate.refined,
        "residual": candidate.residual_deg,
        "share": candidate.terrain_share,
        "covariance": candidate.covariance_m2,
        "convergence": candidate.convergence_deg,
    }
