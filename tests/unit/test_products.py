"""Whether a DEM is of the surface or of the bare ground."""

import numpy as np
import pytest
from dem_files import write

from skyline.terrain.conventions import GROUND, SURFACE, UNKNOWN, model_of


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("davos_srtm1_30m.tif", f"{SURFACE}, SRTM"),
        ("Copernicus_DSM_COG_10_N46_00_E009_00_DEM.tif", f"{SURFACE}, Copernicus"),
        ("N046E009_AVE_DSM.tif", SURFACE),
        ("USGS_13_n37w119.tif", f"{GROUND}, 3DEP"),
        ("tirol_dtm_5m.asc", GROUND),
        ("N46E009_FABDEM_V1-2.tif", f"{GROUND}, FABDEM"),
        ("N46E009.hgt.gz", UNKNOWN),
    ],
)
def test_a_product_is_known_by_its_name(name, model):
    assert model_of([name]) == model


def test_a_product_is_known_by_a_tag_and_files_must_agree(tmp_path):
    tags = {"SKYLINE_SOURCE": "https://host/Copernicus_DSM_COG_10_N46_00_E009_00_DEM.tif"}
    tagged = str(write(tmp_path / "a.tif", np.ones((3, 3), np.float32), tags=tags))
    plain = str(write(tmp_path / "b.tif", np.ones((3, 3), np.float32)))
    assert model_of([tagged]) == f"{SURFACE}, Copernicus"
    assert model_of([plain]) == UNKNOWN
    assert model_of([tagged, plain]) == UNKNOWN
    assert model_of([]) == UNKNOWN
