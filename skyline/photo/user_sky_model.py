"""Skylines of sky segmentation models that a user brings.

A model, in ONNX, must have one input, float32 (1, 3, h, w), RGB from 0 to 1; the first output is
(1, 1, h', w'), (1, h', w') or (1, 2, h', w'), the sky's probability or logits; if it has two
channels, the second is the sky. The photo is resized to the h and w that the model states, or else
to at most 1024 px a side, rounded to multiples of 32.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skyline.arrays import Float64Array, UInt8Array
from skyline.errors import InputError, MissingFileError, library
from skyline.photo.borders import content_of
from skyline.photo.sky_mask import topmost_border
from skyline.photo.skyline import PhotoSkyline

_LONGEST_PX = 1024
"""Longest side of the input of a model that states no size."""
_MULTIPLE_PX = 32
"""The sides of such an input are multiples of this, as most networks demand."""
_STEP_SHARE = 0.012
"""Distance above and below the border at which the probability is read, as a share of all rows."""
_MIN_TRUST = 0.5
"""Least fall of the probability across the border; columns with less are masked."""
_CONTRACT = "expected one input (1, 3, h, w) and an output (1, 1, h, w), (1, h, w) or (1, 2, h, w)"


def load_sky_model(path: str | Path) -> Any:
    """Load a model that keeps this module's contract into onnxruntime.

    Raises `MissingFileError`, and `InputError` if onnxruntime is not installed or the file is not a
    model.
    """
    if not Path(path).is_file():
        raise MissingFileError(f"{path} does not exist; expected a sky model (ONNX)")
    runtime = library("onnxruntime", str(path))
    try:
        return runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    except Exception as error:  # The runtime's errors share no base class.
        raise InputError(f"{path} is not a model that can be run ({_line(error)})") from error


def model_skyline(image: UInt8Array, session: Any) -> PhotoSkyline:
    """Find the skyline of a photo with a sky model.

    The photo is (H, W, 3) uint8 RGB. A column's skyline is its topmost crossing of one half; its
    trust is the fall of the probability there within a hundredth of the rows. Raises `InputError`
    if the model breaks the contract, or no column has sky above ground. ``session`` is the file of
    a model, or what `load_sky_model` returns.
    """
    if isinstance(session, str | Path):
        session = load_sky_model(session)
    content = content_of(image)
    photo = content.crop(image)
    probability = _probability(photo, session)
    row_px, trust = _border(probability)
    row_px = (row_px + 0.5) * len(photo) / len(probability) - 0.5
    at = (np.arange(photo.shape[1]) + 0.5) * len(row_px) / photo.shape[1] - 0.5
    at = np.clip(at, 0.0, len(row_px) - 1.0)
    left = np.floor(at).astype(np.intp)
    right = np.minimum(left + 1, len(row_px) - 1)
    # Beside a masked column the row is NaN, since there is nothing to interpolate to.
    row = np.interp(at, np.arange(len(row_px)), row_px)
    skyline = content.skyline(row, np.minimum(trust[left], trust[right]))
    if not skyline.trusted.any():
        raise InputError("no skyline found: the sky model sees no sky above ground in any column")
    return skyline


def _probability(photo: UInt8Array, session: Any) -> Float64Array:
    """Return the sky's probability (h, w) as the model's output has it."""
    inputs = session.get_inputs()
    if len(inputs) != 1 or len(inputs[0].shape) != 4:
        raise InputError(f"the sky model's inputs are {[i.shape for i in inputs]}; {_CONTRACT}")
    shrink = min(1.0, _LONGEST_PX / max(photo.shape[:2]))
    height, width = (
        stated
        if isinstance(stated, int) and stated > 0
        else max(1, round(side * shrink / _MULTIPLE_PX)) * _MULTIPLE_PX
        for stated, side in zip(inputs[0].shape[2:], photo.shape[:2], strict=True)
    )
    small = cv2.resize(photo, (width, height), interpolation=cv2.INTER_AREA)
    planes = np.ascontiguousarray(small.transpose(2, 0, 1)[np.newaxis], dtype=np.float32)
    try:
        outputs = session.run(None, {inputs[0].name: planes / np.float32(255.0)})
    except Exception as error:  # The runtime's errors share no base class.
        raise InputError(f"the sky model failed ({_line(error)}); {_CONTRACT}") from error
    sky = np.asarray(outputs[0], dtype=np.float64)
    if sky.ndim == 3:
        sky = sky[:, np.newaxis]
    if sky.ndim != 4 or sky.shape[0] != 1 or sky.shape[1] not in {1, 2} or min(sky.shape) < 1:
        raise InputError(f"the sky model's output has shape {sky.shape}; {_CONTRACT}")
    if not np.isfinite(sky).all():
        raise InputError(f"the sky model's output is not finite; {_CONTRACT}")
    if sky.min() >= 0.0 and sky.max() <= 1.0:  # Probabilities.
        return np.asarray(sky[0, -1])
    logit = sky[0, 0] if sky.shape[1] == 1 else sky[0, 1] - sky[0, 0]
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(logit, -50.0, 50.0))))


def _border(probability: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return the row and the trust of each column's border.

    They are NaN and 0 where there is none.
    """
    height, width = probability.shape
    row_px, first = topmost_border(probability, 0.5)
    columns = np.arange(width)
    step = max(1, round(_STEP_SHARE * height))
    sky = probability[np.maximum(first - 1 - step, 0), columns]
    ground = probability[np.minimum(first + step, height - 1), columns]
    trust = np.where(np.isfinite(row_px), np.clip(sky - ground, 0.0, 1.0), 0.0)
    trusted = trust >= _MIN_TRUST
    return np.where(trusted, row_px, np.nan), np.where(trusted, trust, 0.0)


def _line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0][:160]
