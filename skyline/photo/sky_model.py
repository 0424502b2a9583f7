"""Skylines of sky masks, white for sky and black for ground, and of sky segmentation models.

A sky segmentation model in ONNX may replace the built-in extraction. The model must have one input,
float32 (1, 3, h, w), RGB from 0 to 1; the first output is (1, 1, h', w'), (1, h', w') or (1, 2, h',
w'), the sky's probability or logits; if it has two channels, the second is the sky. The photo is
resized to the h and w that the model states, or else to at most 1024 px a side, rounded to
multiples of 32.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skyline.arrays import Float64Array, IntArray, UInt8Array
from skyline.errors import InputError, MissingFileError, library
from skyline.photo.extract import content_of
from skyline.photo.skyline import PhotoSkyline

_NEARLY = 24
"""Levels within which a pixel counts as black or white: masks saved as JPEG ring."""
_MIN_SHARE = 0.98
"""Least share of a mask's pixels that are nearly black or white; the rest is its border."""
_SAMPLES = 500
_MOST_CHANGES = 15.0
"""Most changes between black and white down a column of a mask, in the mean of the columns: masks
of photos have about 2, dithered photos 90 or more."""
_MIDDLE = 127.5
_FLAT_PX, _MOST_FLAT, _MOST_WHITE = 1.0, 0.9, 0.1
"""A border is taken for the frame of a mask with white ground if it lies within `_FLAT_PX` of its
median in more than `_MOST_FLAT` of the columns, and if more than `_MOST_WHITE` of the pixels below
it are white."""

_LONGEST_PX = 1024
_MULTIPLE_PX = 32
_STEP_SHARE = 0.012
"""Distance above and below the border, as a share of all rows, over which the fall is measured."""
_MIN_TRUST = 0.5
"""Least fall of the probability across the border; columns below it are masked."""
_CONTRACT = "expected one input (1, 3, h, w) and an output (1, 1, h, w), (1, h, w) or (1, 2, h, w)"


def load_sky_model(path: str | Path) -> Any:
    """Return the ``onnxruntime.InferenceSession`` of a model that keeps this module's contract.

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
    """Find the skyline of a photo (H, W, 3) uint8 RGB with a sky model.

    A column's skyline is its topmost crossing of one half; its trust is the fall of the
    probability there within a hundredth of the rows. Raises `InputError` if the model breaks the
    contract, or no column has sky above ground. ``session`` is the file of a model, or as of
    `load_sky_model`.
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
    query = content.skyline(row, np.minimum(trust[left], trust[right]))
    if not query.trusted.any():
        raise InputError("no skyline found: the sky model sees no sky above ground in any column")
    return query


def _probability(photo: UInt8Array, session: Any) -> Float64Array:
    """Return the sky's probability at the size of the model's output, (h, w)."""
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
    """Return row and trust of each column's border; NaN and 0 if there is none."""
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


def is_sky_mask(image: UInt8Array) -> bool:
    """Return whether an RGB image (H, W, 3) uint8 is grey, nearly all black or white, in few areas.

    About five hundred rows and columns are sampled. A dithered photo is no mask.
    """
    step_down, step_across = (max(1, side // _SAMPLES) for side in image.shape[:2])
    sample = image[::step_down, ::step_across].astype(np.int16)
    grey = sample[:, :, 1]
    coloured = np.abs(sample - grey[:, :, np.newaxis]).max(axis=2) > _NEARLY
    extreme = (grey <= _NEARLY) | (grey >= 255 - _NEARLY)
    changes = np.count_nonzero(np.diff(grey >= _MIDDLE, axis=0)) / grey.shape[1]
    return not coloured.any() and float(extreme.mean()) >= _MIN_SHARE and changes <= _MOST_CHANGES


def skyline_of_mask(image: UInt8Array) -> PhotoSkyline:
    """Return the border above each column's topmost ground; NaN if it has no sky above ground.

    A smoothed border is found to a fraction of a pixel, halfway from white to black. Raises
    `InputError` if no column of the mask, (H, W, 3) uint8, has sky (white) above ground, if more
    columns begin with black above white than have a skyline, or if white ground in a white frame is
    taken for sky.
    """
    sky = image[:, :, 1].astype(np.float64)
    row_px, first = topmost_border(sky, _MIDDLE)
    drawn, white = np.isfinite(row_px), np.count_nonzero(sky >= _MIDDLE, axis=0)
    found = ""
    if np.count_nonzero((white > _MOST_WHITE * len(sky)) & (sky[0] < _MIDDLE)) > drawn.sum():
        found = "black above white, as one with white ground or in a black frame"
    elif not drawn.any():
        found = "no sky above ground"
    elif (
        np.mean(np.abs(row_px - np.nanmedian(row_px))[drawn] <= _FLAT_PX) > _MOST_FLAT
        and (white - first)[drawn].sum() > _MOST_WHITE * (len(sky) - first)[drawn].sum()
    ):
        found = (
            f"a straight border at row {np.nanmedian(row_px):.0f} and white below it, as one with "
            "white ground in a white frame"
        )
    if found:
        raise InputError(
            "no skyline found: the picture is black and white alone, as a sky mask is, and has "
            f"{found}; expected white for the sky, black for the ground, and no frame"
        )
    return PhotoSkyline(row_px, drawn.astype(np.float64), image.shape[1], len(image))


def topmost_border(sky: Float64Array, middle: float) -> tuple[Float64Array, IntArray]:
    """Return the row at which each column (w,) of a sky image (h, w) first falls below a middle.

    The row is fractional, NaN if the column never falls or starts below the middle. The second
    array is the row of the first pixel of ground.
    """
    is_ground = sky < middle
    first = np.argmax(is_ground, axis=0)
    # The skyline lies above the image if a column starts with ground, below it if it has none.
    seen = is_ground.any(axis=0) & (first > 0)
    columns = np.arange(sky.shape[1])
    above, below = sky[first - 1, columns], sky[first, columns]
    row_px = first - 1 + (above - middle) / np.where(seen, above - below, 1.0)
    return np.where(seen, row_px, np.nan), first
