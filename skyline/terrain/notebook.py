"""How a thing shows itself in a notebook: a small picture beside a table of facts."""

import base64
import io
from collections.abc import Mapping
from html import escape

import numpy as np
from numpy.typing import NDArray

from skyline.errors import printable

_LONGEST_PX = 240


def facts_html(facts: Mapping[str, str], picture: NDArray[np.uint8] | None = None) -> str:
    """Return named facts as HTML, beside a grey picture (H, W) if there is one."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(printable(fact))}</td></tr>"
        for name, fact in facts.items()
    )
    drawn = ""
    if picture is not None:
        from PIL import Image  # noqa: PLC0415  (nothing else here needs it)

        file = io.BytesIO()
        Image.fromarray(picture).save(file, format="PNG")
        style = f"width: {_LONGEST_PX * picture.shape[1] // max(picture.shape)}px"
        source = f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"
        drawn = f'<img alt="map" style="{style}" src="{source}">'
    return (
        '<div style="display: flex; gap: 1em; align-items: flex-start">'
        f"{drawn}<table>{rows}</table></div>"
    )


def relief(heights_m: NDArray[np.floating], east_m: float, north_m: float) -> NDArray[np.uint8]:
    """Return a small picture of terrain lit from the north-west; holes are light.

    Parameters
    ----------
    heights_m : (rows, cols) float
        Row 0 is the northernmost.
    east_m, north_m : float
        From sample to sample.
    """
    step = -(-max(heights_m.shape) // _LONGEST_PX)
    some = np.atleast_2d(heights_m[::step, ::step].astype(np.float64))
    if min(some.shape) < 2:
        return np.full(some.shape, 220, dtype=np.uint8)
    south, east = np.gradient(some, north_m * step, east_m * step)
    light = (np.sqrt(2.0) + east + south) / (2.0 * np.sqrt(1.0 + east**2 + south**2))
    picture: NDArray[np.uint8]
    picture = np.nan_to_num(40.0 + 200.0 * light.clip(0.0, 1.0), nan=220.0).astype(np.uint8)
    return picture
