"""The sensors of cameras, from lensfun's database (https://lensfun.github.io)."""

import re
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from math import hypot

FULL_FRAME_MM = hypot(36.0, 24.0)
"""Diagonal of 35 mm film."""
_SEVERAL_SENSORS = re.compile("apple|honor|huawei|lg|microsoft|nokia|samsung sm-", re.IGNORECASE)
"""Phones: the model does not say which of its cameras took a photo."""
_ONE_SENSOR_RATIO = 1.05
"""Ratio of two sensors of a model beyond which it has several."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """The sensor of a camera.

    Attributes
    ----------
    camera : str
        The camera's name.
    diagonal_mm : float
    """

    camera: str
    diagonal_mm: float

    @property
    def shape(self) -> float:
        """Width over height.

        It is 3:2 for full frame, APS and 1 inch, 4:3 for all others.
        """
        is_3_to_2 = 24.0 < self.diagonal_mm < 46.0 or 15.0 < self.diagonal_mm < 17.0
        return 3 / 2 if is_3_to_2 else 4 / 3

    def cropped_mm(self, frame: tuple[float, float]) -> float:
        """Return the diagonal of the largest part of a frame's shape."""
        return self.diagonal_mm * cropped_diagonal(self.shape, max(frame) / min(frame))


def cropped_diagonal(shape: float, kept: float) -> float:
    """Return the share of a shape's diagonal that its largest part keeps.

    The part has the shape ``kept``; shapes are widths over heights.
    """
    return min(shape / kept, 1.0) * hypot(kept, 1.0) / hypot(shape, 1.0)


def sensor_of(model: str) -> Sensor | None:
    """Return the sensor of a camera's model.

    Returns None unless the model is known to have one sensor.
    """
    return _sensors_by_model().get(_model_key(model))


@cache
def _sensors_by_model() -> dict[str, Sensor]:
    """Return the sensors of models that have one, by their keys."""
    found = defaultdict(list)
    with suppress(ImportError):  # There are no wheels for some machines.
        for one in import_module("lensfunpy").Database().cameras:
            if not _SEVERAL_SENSORS.match(f"{one.maker} {one.model}"):
                found[_model_key(one.model)].append(
                    Sensor(one.model, FULL_FRAME_MM / one.crop_factor)
                )
    return {
        key: sensors[0]
        for key, sensors in found.items()
        if max(one.diagonal_mm for one in sensors)
        < _ONE_SENSOR_RATIO * min(one.diagonal_mm for one in sensors)
    }


def _model_key(model: str) -> str:
    """Return a model without case and spaces, which makers write differently."""
    return "".join(model.split()).upper()
