"""A sky model of the user's own: its contract, through a stand-in and, if installed, for real."""

from dataclasses import dataclass
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
from photo_scenes import make_scene
from PIL import Image

from skyline.errors import InputError, MissingFileError
from skyline.photo.read import read_skyline
from skyline.photo.user_sky_model import load_sky_model, model_skyline


@dataclass
class BlueSky:
    """A model that takes what is bluer than red for sky, at a slope of the threshold."""

    size: tuple[object, object] = ("h", "w")
    form: str = "probability"
    seen: tuple[int, ...] = ()

    def get_inputs(self):
        return [SimpleNamespace(name="photo", shape=[1, 3, *self.size])]

    def run(self, names, feed):
        photo = feed["photo"]
        assert photo.dtype == np.float32
        assert 0.0 <= photo.min() <= photo.max() <= 1.0
        self.seen = photo.shape
        logit = 40.0 * (photo[:, 2:] - photo[:, :1] - 0.08)
        sky = 1.0 / (1.0 + np.exp(-logit))
        return {
            "probability": [sky],
            "flat": [sky[:, 0]],
            "two": [np.concatenate([1.0 - sky, sky], axis=1)],
            "logits": [logit],
            "two logits": [np.concatenate([-logit / 2.0, logit / 2.0], axis=1)],
        }[self.form]


@pytest.mark.parametrize("form", ["probability", "flat", "two", "logits", "two logits"])
def test_every_form_of_output_gives_the_skyline(form):
    scene = make_scene("clear", 3, 640, 480)
    query = model_skyline(scene.image, BlueSky(form=form))
    error_px = np.abs(query.row_px - scene.row_px)[query.trusted]
    assert query.trusted.mean() > 0.95
    assert np.median(error_px) < 0.5
    assert ((query.trust > 0.0) == query.trusted).all()


def test_photo_is_brought_to_the_size_the_model_takes():
    scene = make_scene("clear", 3, 640, 480)
    fixed = BlueSky((240, 320))
    query = model_skyline(scene.image, fixed)
    assert fixed.seen == (1, 3, 240, 320)
    assert np.median(np.abs(query.row_px - scene.row_px)[query.trusted]) < 1.0
    free = BlueSky()
    model_skyline(make_scene("clear", 3, 2100, 700).image, free)
    assert free.seen == (1, 3, 352, 1024)


RAMP = np.linspace(1.0, 0.0, 64)[np.newaxis, np.newaxis, :, np.newaxis] * np.ones((1, 1, 64, 64))


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (np.ones((1, 3, 8, 8)), r"shape \(1, 3, 8, 8\); expected one input"),
        (np.ones(4), "expected one input"),
        (np.full((1, 1, 8, 8), np.nan), "not finite"),
        (np.ones((1, 1, 64, 64)), "sees no sky above ground"),
        (RAMP, "sees no sky above ground"),  # sure of no row
        (RuntimeError("bad shape\nmore"), r"failed \(bad shape\)"),
    ],
)
def test_output_that_breaks_the_contract_is_refused(output, message):
    # One exception is raised, and a list is what calls return in turn.
    is_error = isinstance(output, Exception)
    model = BlueSky()
    model.run = MagicMock(side_effect=output if is_error else [[output]])
    with pytest.raises(InputError, match=message) as caught:
        model_skyline(make_scene("clear", 3, 64, 64).image, model)
    assert "\n" not in str(caught.value)


def test_absent_runtime_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    (tmp_path / "sky.onnx").write_bytes(b"model")
    Image.fromarray(make_scene("clear", 3, 320, 240).image).save(tmp_path / "photo.png")
    with pytest.raises(InputError, match="pip install onnxruntime"):
        read_skyline(tmp_path / "photo.png", sky_model=tmp_path / "sky.onnx")
    with pytest.raises(MissingFileError, match=r"absent\.onnx does not exist"):
        load_sky_model(tmp_path / "absent.onnx")
