"""A peer to be measured against: GRASS' r.horizon, place by place (`grass` on the path).

r.horizon puts the eye on the ground of the nearest sample, knows no curvature in metric frames,
counts its azimuths from true north and has no angle below zero. So its map is the height field, and
it is compared with skylines from that sample, on a flat Earth, cut off at zero.
"""

import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import SkylineError
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.measuring.geotiff import write_geotiff

_SCRIPT = """set -e
r.in.gdal input={dem} output=dem --quiet
g.region raster=dem
for place in {places}; do
  r.horizon -dc elevation=dem step={step} coordinates=$place
  date +"took %s.%N"
done
"""


def is_installed() -> bool:
    """Whether ``grass`` is there to be run."""
    return shutil.which("grass") is not None


def horizons(
    field: HeightField, eyes: Viewpoints, step_deg: float
) -> tuple[Float64Array, Float64Array]:
    """Return r.horizon's elevation angles (N, A) from true north, and seconds (N - 1,).

    The field is without holes; heights of the eyes (N) are not used. Seconds are those of each
    place but the first.
    """
    with tempfile.TemporaryDirectory() as folder:
        dem, script = Path(folder, "dem.tif"), Path(folder, "horizons.sh")
        # The samples are the centres of the raster's cells.
        step = field.spacing_east_m, field.spacing_north_m
        corner = field.west_m - 0.5 * step[0], field.north_m + 0.5 * step[1]
        write_geotiff(dem, field.heights_m.astype(np.float32), field.frame.wkt, corner, step)
        places = [f"{e},{n}" for e, n in zip(eyes.easting_m, eyes.northing_m, strict=True)]
        text = _SCRIPT.format(dem=dem, step=step_deg, places=" ".join(places))
        script.write_text(text, encoding="utf-8")
        begun = time.perf_counter()
        done = subprocess.run(
            ["grass", "--tmp-location", str(dem), "--exec", "sh", str(script)],
            capture_output=True,
            text=True,
            check=False,
        )
        taken = time.perf_counter() - begun
    angles = re.findall(r"^([\d.]+),(-?[\d.]+)$", done.stdout, re.MULTILINE)
    ends = np.array(re.findall(r"^took ([\d.]+)$", done.stdout, re.MULTILINE), dtype=np.float64)
    steps = round(360.0 / step_deg)
    if done.returncode or len(ends) != len(eyes) or len(angles) < len(eyes) * steps:
        stderr = " ".join(done.stderr.split())[-200:]
        raise SkylineError(f"r.horizon gave {len(angles)} angles in {taken:.0f} s: {stderr}")
    table = np.array(angles, dtype=np.float64).reshape(len(eyes), -1, 2)
    order = np.argsort(np.round(table[0, :, 0] % 360.0, 6), kind="stable")
    return table[:, order, 1][:, -steps:], np.diff(ends)
