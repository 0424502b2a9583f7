"""Verification: a query's whole curve laid on what each of a shortlist's eyes sees."""

from dataclasses import replace

import numpy as np

from skyline.errors import InputError
from skyline.matching.hypotheses import Hypotheses
from skyline.matching.noise import Noise
from skyline.matching.panoramas import Panoramas
from skyline.matching.query import QueryRays
from skyline.matching.rays import thinned
from skyline.matching.solver import HEADING, PITCH, ROLL, Curves, Fit, Solver, SolverConfig

VERIFICATION = SolverConfig(iterations=8, noise=Noise(nodes=0))
"""Quick and tolerant: the skyline's height errors count as independent."""


def verify(
    hypotheses: Hypotheses,
    panoramas: Panoramas,
    query: QueryRays,
    config: SolverConfig = VERIFICATION,
) -> Hypotheses:
    """Solve heading, pitch, roll and field of view of every hypothesis where it stands.

    Headings must be near enough for the curves to overlap, some degrees. What a skyline does
    not tell stays as it was: a level one has no heading, a straight one no field of view, and
    pitch and roll are drawn to the level camera's. The field of view keeps to the query's range.

    Parameters
    ----------
    hypotheses : Hypotheses
        M of them.
    panoramas : Panoramas
        What each of their M eyes sees.
    query : QueryRays
    config : SolverConfig

    Returns
    -------
    Hypotheses
        In the same order; the score is the negative logarithm of the likelihood, infinite where
        fewer than ``config.min_columns`` columns have a known skyline on both sides.

    Raises
    ------
    InputError
        There are not as many panoramas as hypotheses.
    """
    if len(panoramas) != len(hypotheses):
        raise InputError(
            f"{len(panoramas)} panoramas for {len(hypotheses)} hypotheses; expected one of each"
        )
    solver = Solver(thinned(query, panoramas.bins), config)
    curves = Curves.of(panoramas, np.zeros((len(panoramas), 2)))
    fit = solver.settle(curves, solver.start(hypotheses))
    return posed(hypotheses, fit, solver)


def posed(hypotheses: Hypotheses, fit: Fit, solver: Solver) -> Hypotheses:
    """Return hypotheses with the attitude, the field of view and the cost of a fit."""
    return replace(
        hypotheses,
        heading_deg=np.degrees(fit.state[:, HEADING]) % 360.0,
        pitch_deg=np.degrees(fit.state[:, PITCH]),
        roll_deg=np.degrees(fit.state[:, ROLL]),
        fov_deg=solver.fov_deg(fit.state),
        score=fit.cost,
    )
