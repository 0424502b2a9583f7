"""From the costs of areas to that of a larger one, and what this takes for granted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from skyline.camera import HEADINGS
from skyline.experiments.area_cost import (
    Area,
    AreaCost,
    BuildCost,
    MatchCost,
    opening_bytes,
    predicted_places,
)

_M2_IN_KM2 = 1e6


@dataclass(frozen=True, slots=True)
class Line:
    """A cost that is ``fixed + each * n``, neither below 0."""

    fixed: float
    each: float

    @classmethod
    def fit(cls, n: Sequence[float], cost: Sequence[float]) -> "Line":
        """Fit costs by least squares of their relative errors, so that small ones count as much.

        Where they do not grow with n, noise hides what each costs: that of the greatest n is then
        taken for proportional, which is more than it can be.
        """
        n_, cost_ = np.asarray(n, dtype=np.float64), np.asarray(cost, dtype=np.float64)
        design = np.column_stack([np.ones_like(n_), n_]) / cost_[:, np.newaxis]
        (fixed, each), _ = nnls(design, np.ones_like(n_))
        if each > 0.0 and len(n_) > 1:
            return cls(float(fixed), float(each))
        most = int(np.argmax(n_))
        return cls(0.0, float(cost_[most] / n_[most]))

    def at(self, n: float) -> float:
        """Return the cost of n."""
        return self.fixed + self.each * n


def extrapolate(
    one: BuildCost, measured: Sequence[AreaCost], probe: AreaCost, target_km2: float
) -> dict[str, object]:
    """Return the row of an area too large to measure.

    Parameters
    ----------
    one : BuildCost
        Of a single viewpoint: what is fixed.
    measured : sequence of AreaCost
        At least one; of one spacing and one number of shells.
    probe : AreaCost
        A patch at the target's spacing.
    target_km2 : float

    Returns
    -------
    dict
        The keys of a measured row; beside them what times and bytes are at the probe's rate, the
        memory that opening the store would take, and the `assumptions`.
    """
    target = Area(target_km2, probe.area.spacing_m, probe.area.shells)
    viewpoints = round(target_km2 * _M2_IN_KM2 / target.spacing_m**2)
    renderings = len(HEADINGS) * viewpoints
    places = predicted_places(target_km2, viewpoints)
    builds = [one, *(cost.build for cost in measured)]
    n = [build.renderings for build in builds]
    seconds = Line.fit(n, [build.build_s for build in builds])
    cpu = Line.fit(n, [build.build_cpu_s for build in builds])
    size = Line.fit(n, [build.bytes for build in builds])
    matched = [cost.match for cost in measured if isinstance(cost.match, MatchCost)]
    query_ms = None
    if len(matched) > 1:
        line = Line.fit([cost.places for cost in matched], [cost.query_ms for cost in matched])
        query_ms = line.at(places)
    return {
        "area_km2": target_km2,
        "spacing_m": target.spacing_m,
        "shells": target.shells,
        "renderings": renderings,
        "build_s": seconds.at(renderings),
        "build_cpu_s": cpu.at(renderings),
        "build_s_at_probe_rate": renderings * probe.build.seconds_a_rendering,
        "build_cpu_s_at_probe_rate": renderings * probe.build.cpu_seconds_a_rendering,
        "bytes": round(size.at(renderings)),
        "bytes_at_probe_rate": round(renderings * probe.build.bytes_a_rendering),
        "ms_a_rendering": 1e3 * seconds.each,
        "cpu_ms_a_rendering": 1e3 * cpu.each,
        "bytes_a_rendering": size.each,
        "places": places,
        "query_ms": query_ms,
        "opening_bytes": opening_bytes(places, viewpoints, target.shells),
        "assumptions": [
            _of_build(measured, seconds, cpu, size),
            _of_spacing(measured[0].area.spacing_m, probe),
            "the terrain is like this, seen as far; one process on this machine builds it all",
            _of_query(matched),
        ],
    }


def _of_build(measured: Sequence[AreaCost], seconds: Line, cpu: Line, size: Line) -> str:
    areas = ", ".join(f"{cost.area.km2:g}" for cost in measured)
    rates = [1e3 * cost.build.seconds_a_rendering for cost in measured]
    return (
        f"a build takes {seconds.fixed:.1f} s and {1e3 * seconds.each:.3f} ms a rendering "
        f"({1e3 * cpu.each:.3f} ms of processor time), a store {size.fixed / 1e3:.0f} kB and "
        f"{size.each:.0f} bytes a rendering: fits to one viewpoint and {areas} km2, which took "
        f"{min(rates):.3f} to {max(rates):.3f} ms a rendering in all"
    )


def _of_spacing(spacing_m: float, probe: AreaCost) -> str:
    return (
        f"viewpoints {probe.area.spacing_m:g} m apart cost what they cost {spacing_m:g} m apart; "
        f"a patch of {probe.area.km2:g} km2 took {1e3 * probe.build.seconds_a_rendering:.3f} ms "
        f"({1e3 * probe.build.cpu_seconds_a_rendering:.3f} ms of processor time) and "
        f"{probe.build.bytes_a_rendering:.0f} bytes a rendering"
    )


def _of_query(matched: Sequence[MatchCost]) -> str:
    if len(matched) < 2:
        return "query time is not extrapolated: fewer than two areas were matched"
    places = ", ".join(f"{cost.places:,}" for cost in matched)
    return (
        f"a query's time is linear in the places compared, as fitted to {places}, and the machine "
        "has the memory to hold them"
    )
