"""The registry of strategies: which viewpoint to render next, each under its own name."""

from skyline.coverage import Strategy
from skyline.paper.strategies import arov, hov, lpov, rov, sov
from skyline.planning.cover import cover

STRATEGIES: dict[str, Strategy] = {
    "rov": rov,
    "arov": arov,
    "hov": hov,
    "sov": sov,
    "lpov": lpov,
    "cover": cover,
}
"""The paper's five, then ours."""
