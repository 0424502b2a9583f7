"""The horizon rasterizer equals the oracle on fields and eyes that hypothesis makes up."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import at_m, field_of

from skyline.geodesy.earth import Curvature
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth.agreement import HORIZON, SkylineScene, oracle_truth


@dataclass(frozen=True)
class Recipe:
    """The parameters of a field and of the eyes on it; positions are dyadic, so exact."""

    rows: int
    cols: int
    spacing_north_m: float
    relief: str
    base_m: float
    hole_share: float
    eye_place: str
    eye_height_m: float
    width: int
    curvature: Curvature
    seed: int


RELIEFS = {
    "constant": lambda generator, shape: np.zeros(shape),
    "rough": lambda generator, shape: generator.normal(size=shape) * 40.0,
    "steps": lambda generator, shape: generator.integers(0, 3, shape) * 25.0,
    "needles": lambda generator, shape: 300.0 * (generator.random(shape) < 0.03),
    "slope": lambda generator, shape: np.add.outer(*(np.arange(n) * 8.0 for n in shape)),
    "hills": lambda generator, shape: np.cumsum(np.cumsum(generator.normal(size=shape), 0), 1),
}

PLACES = {
    "sample": lambda row, col, share: (np.floor(row), np.floor(col)),
    "row": lambda row, col, share: (np.floor(row), col),
    "column": lambda row, col, share: (row, np.floor(col)),
    "diagonal": lambda row, col, share: (np.floor(row) + share, np.floor(col) + share),
    "anywhere": lambda row, col, share: (row, col),
    "beside a sample": lambda row, col, share: (np.floor(row) + share / 4096, np.floor(col)),
}

recipes = st.builds(
    Recipe,
    rows=st.integers(1, 40),
    cols=st.integers(1, 40),
    spacing_north_m=st.sampled_from([16.0, 16.0, 5.0, 12.0, 47.0]),
    relief=st.sampled_from(sorted(RELIEFS)),
    base_m=st.sampled_from([0.0, 1500.0, 8000.0, -400.0]),
    hole_share=st.sampled_from([0.0, 0.0, 0.02, 0.2, 0.6]),
    eye_place=st.sampled_from(sorted(PLACES)),
    eye_height_m=st.sampled_from([0.0, 2.0**-6, 0.5, 2.0, 17.0, 100.0]),
    width=st.sampled_from([2, 3, 5, 8, 31, 64, 97]),
    curvature=st.sampled_from(
        [Curvature(), Curvature(enabled=False), Curvature(3.4e6, 0.0), Curvature(1e4, 0.25)]
    ),
    seed=st.integers(0, 2**32 - 1),
)


def scene_of(recipe):
    generator = np.random.default_rng(recipe.seed)
    shape = (recipe.rows, recipe.cols)
    heights = (recipe.base_m + RELIEFS[recipe.relief](generator, shape)).astype(np.float32)
    heights[generator.random(shape) < recipe.hole_share] = np.nan
    spacings_m, corner = (16.0, recipe.spacing_north_m), (2.0**19, 2.0**22)
    field = field_of(heights, *spacings_m, *corner)
    row, col, share = generator.integers(0, 64, (3, 40)) / 64.0
    most = 0.999 * np.array([recipe.rows - 1, recipe.cols - 1])
    row, col = PLACES[recipe.eye_place](row * most[0], col * most[1], share)
    row, col = (np.round(place * 2**18) / 2**18 for place in (row, col))
    place = np.array(field.to_map(np.minimum(row, recipe.rows - 1), col))
    standing = ~np.isnan(field.height_at(**at_m(place)))
    eyes = stand_on(field, **at_m(place[:, standing][:, :2]), eye_height_m=recipe.eye_height_m)
    return SkylineScene(field, eyes, recipe.width, recipe.curvature)


@pytest.mark.slow
@settings(max_examples=30)
@given(recipes)
def test_horizon_equals_the_oracle(recipe):
    scene = scene_of(recipe)
    assume(len(scene.viewpoints) > 0)
    agreement = HORIZON.agreement(scene, HORIZON.render(scene), oracle_truth(scene))
    over = np.flatnonzero(agreement.error_px.ravel() > agreement.bound_px.ravel())
    assert agreement.holds, (
        f"{np.count_nonzero(~agreement.flags_agree)} flags differ; over their bounds: "
        f"{agreement.error_px.flat[over][:5]} px of {agreement.bound_px.flat[over][:5]} px"
    )
