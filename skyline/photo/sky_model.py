"""A sky segmentation model of the user's own, in ONNX, in place of the built-in extraction.

The contract: one input, float32 (1, 3, h, w), RGB from 0 to 1; the first output is (1, 1, h', w'),
(1, h', w') or (1, 2, h', w'), the sky's probability or logits; of two channels the second is the
sky. A model that states its h and w gets these, any other the photo with at most 1024 px a side,
rounded to multiples of 32.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, cast

import cv2
import numpy as np

from skyline.arrays import Float32Array, Float64Array, UInt8Array
from skyline.errors import InputError, MissingFileError
from skyline.extras import library
from skyline.photo.frame import Content, content_of
from skyline.photo.mask import topmost_border
from skyline.photo.query import QuerySkyline

_LONGEST_PX = 1024
_MULTIPLE_PX = 32
_STEP_SHARE = 0.012
"""Rows, as a share of all, above and below the border between which the probability must fall."""
_MIN_CONFIDENCE = 0.5
"""Fall of the probability below which a column is masked."""
_CONTRACT = "expected one input (1, 3, h, w) and an output (1, 1, h, w), (1, h, w) or (1, 2, h, w)"


class SkySession(Protocol):
    """What of ``onnxruntime.InferenceSession`` is used."""

    def get_inputs(self) -> Sequence[Any]:
        """Return the model's inputs."""

    def run(self, names: None, feed: dict[str, Float32Array]) -> Sequence[object]:
        """Return the model's outputs."""


def load_sky_model(path: str | Path) -> SkySession:
    """Open an ONNX model; see this module for what it takes and gives.

    Raises `MissingFileError`, and `InputError` where onnxruntime is not installed or the file is
    not a model.
    """
    if not Path(path).is_file():
        raise MissingFileError(f"{path} does not exist; expected a sky model (ONNX)")
    runtime = library("onnxruntime", "onnx", str(path))
    try:
        session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    except Exception as error:  # The runtime's own errors share no base class.
        raise InputError(f"{path} is not a model that can be run ({_line(error)})") from error
    return cast(SkySession, session)


def model_skyline(image: UInt8Array, session: SkySession) -> QuerySkyline:
    """Find the skyline of a photo (H, W, 3) uint8 RGB with a sky model.

    A column's skyline is its topmost crossing of one half; its confidence is how far the
    probability falls there within a hundredth of the rows. Raises `InputError` where the model does
    not keep the contract, or no column has sky above ground.
    """
    content = content_of(image)
    photo = content.crop(image)
    probability = _probability(photo, session)
    row_px, confidence = _border(probability)
    photo_row = (row_px + 0.5) * len(photo) / len(probability) - 0.5
    query = _on_photo(photo_row, confidence, content, image.shape[:2])
    if not query.trusted.any():
        raise InputError("no skyline found: the sky model sees no sky above ground in any column")
    return query


def _probability(photo: UInt8Array, session: SkySession) -> Float64Array:
    """Return the sky's probability, (h, w) as the model gives it."""
    inputs = session.get_inputs()
    if len(inputs) != 1 or len(inputs[0].shape) != 4:
        raise InputError(f"the sky model's inputs are {[i.shape for i in inputs]}; {_CONTRACT}")
    height, width = _input_size(inputs[0].shape, photo.shape)
    small = cv2.resize(photo, (width, height), interpolation=cv2.INTER_AREA)
    planes = np.ascontiguousarray(small.transpose(2, 0, 1)[np.newaxis], dtype=np.float32)
    try:
        outputs = session.run(None, {inputs[0].name: planes / np.float32(255.0)})
    except Exception as error:  # As above.
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


def _input_size(shape: Sequence[object], photo: tuple[int, ...]) -> tuple[int, int]:
    shrink = min(1.0, _LONGEST_PX / max(photo[:2]))
    sides = []
    for stated, side in zip(shape[2:], photo[:2], strict=True):
        free = max(1, round(side * shrink / _MULTIPLE_PX)) * _MULTIPLE_PX
        sides.append(stated if isinstance(stated, int) and stated > 0 else free)
    return sides[0], sides[1]


def _border(probability: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return row and confidence of each column's border, NaN and 0 where there is none."""
    height, width = probability.shape
    row_px, first = topmost_border(probability, 0.5)
    columns = np.arange(width)
    step = max(1, round(_STEP_SHARE * height))
    sky = probability[np.maximum(first - 1 - step, 0), columns]
    ground = probability[np.minimum(first + step, height - 1), columns]
    confidence = np.where(np.isfinite(row_px), np.clip(sky - ground, 0.0, 1.0), 0.0)
    trusted = confidence >= _MIN_CONFIDENCE
    return np.where(trusted, row_px, np.nan), np.where(trusted, confidence, 0.0)


def _on_photo(
    row_px: Float64Array, confidence: Float64Array, content: Content, shape: tuple[int, ...]
) -> QuerySkyline:
    """Return the query of a whole photo from rows and confidences at the model's columns, (w,)."""
    across = content.right - content.left
    at = (np.arange(across) + 0.5) * len(row_px) / across - 0.5
    at = np.clip(at, 0.0, len(row_px) - 1.0)
    left = np.floor(at).astype(np.intp)
    right = np.minimum(left + 1, len(row_px) - 1)
    # Beside a masked column there is nothing to interpolate to: NaN passes on.
    share = at - left
    row = np.where(share > 0.0, (1.0 - share) * row_px[left] + share * row_px[right], row_px[left])
    return content.skyline(row, np.minimum(confidence[left], confidence[right]), shape)


def _line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0][:160]
