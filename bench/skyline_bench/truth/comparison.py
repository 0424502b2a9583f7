"""How far skylines are from the oracle's, in one unit for every width."""

import numpy as np

from skyline.camera import DEFAULT_WIDTH, pixel_size
from skyline.views import Views
from skyline_bench.measuring.record import Row

PIXEL_TAN = pixel_size(DEFAULT_WIDTH)
"""The px of every comparison, 2 / 640 in v, so that errors of different widths compare."""


def compare(views: Views, truth: Views) -> Row:
    """Compare views with the oracle's of the same viewpoints and width.

    Return ``rms_px`` and ``max_px`` over the ``columns`` that neither side flags, None without any.
    ``flagged_share`` of all columns is left out because either side flags them; ``missing`` are
    unflagged columns of the truth where the other has no value, whatever its flags say.
    """
    clear = truth.flags == 0
    missing = clear & np.isnan(views.elevation_tan)
    flagged = ~clear | (views.flags != 0)
    compared = ~flagged & ~missing
    error_px = (views.elevation_tan.astype(np.float64) - truth.elevation_tan)[compared] / PIXEL_TAN
    return {
        "rms_px": float(np.sqrt(np.mean(error_px**2))) if error_px.size else None,
        "max_px": float(np.abs(error_px).max()) if error_px.size else None,
        "columns": int(error_px.size),
        "flagged_share": float(flagged.mean()) if flagged.size else 0.0,
        "missing": int(missing.sum()),
    }
