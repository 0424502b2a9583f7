"""Tables of stores compared, as the terminal and the report both show them."""

from collections.abc import Sequence

from skyline_bench.measuring.record import Row
from skyline_bench.trials.distance_groups import ALL

STORES = {
    "store": "store",
    "renderings": "renderings",
    "bytes": "MB",
    "build_s": "build s",
    "matcher": "matcher",
    "close": "close m",
    "medium": "medium m",
    "far": "far m",
    "mean_m": "all m",
    "mean_m_low": "from",
    "mean_m_high": "to",
    "median_m": "median m",
    "p90_m": "90 % m",
    "within_200m": "in 200 m",
    "query_ms": "ms",
}
REACHED = {
    "goal": "as accurate as",
    "goal_mean_m": "mean m",
    "cost": "in",
    "goal_cost": "that is",
    "matcher": "matcher",
    "planner": "planner",
    "store": "store",
    "mean_m": "mean m",
    "needed": "needs",
    "share": "share",
    "interpolated": "interpolated",
}
EQUAL = {
    "store": "store",
    "matcher": "matcher",
    "renderings": "renderings",
    "mean_m": "mean m",
    "median_m": "median m",
    "uniform_mean_m": "uniform, interpolated",
    "gain": "gain",
}


def store_lines(rows: Sequence[Row]) -> list[Row]:
    """Return a line for each store and matcher: means of every group, the rest over all."""
    lines: dict[tuple[object, object], dict[str, object]] = {}
    for row in rows:
        line = lines.setdefault((row["store"], row["matcher"]), {})
        line[str(row["group"])] = row["mean_m"]
        if row["group"] == ALL:
            line |= row
    return list(lines.values())


def in_megabytes(row: Row) -> Row:
    """Return a row of what stores need, bytes as megabytes."""
    if row["cost"] != "bytes":
        return row
    amounts = {key: row[key] for key in ("goal_cost", "needed", "interpolated")}
    scaled = {
        key: None if value is None else float(str(value)) / 1e6 for key, value in amounts.items()
    }
    return {**row, **scaled, "cost": "MB"}
