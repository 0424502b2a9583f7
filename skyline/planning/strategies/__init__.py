"""Strategies: which viewpoint to render next (paper 4.3), each under its own name."""

from skyline.planning.strategies.base import Requests, Strategy
from skyline.planning.strategies.cover import cover
from skyline.planning.strategies.line import lpov
from skyline.planning.strategies.optimistic import arov, hov, rov
from skyline.planning.strategies.shape import sov

STRATEGIES: dict[str, Strategy] = {
    "rov": rov,
    "arov": arov,
    "hov": hov,
    "sov": sov,
    "lpov": lpov,
    "cover": cover,
}
"""The paper's five, then ours."""

__all__ = ["STRATEGIES", "Requests", "Strategy", "arov", "cover", "hov", "lpov", "rov", "sov"]
