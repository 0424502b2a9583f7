"""Types of arrays for hints, and a base of dataclasses of arrays."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import compress
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError, library

FloatArray = NDArray[np.floating]
Float64Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Complex64Array = NDArray[np.complex64]
Complex128Array = NDArray[np.complex128]
Int64Array = NDArray[np.int64]
IntArray = NDArray[np.intp]
UInt8Array = NDArray[np.uint8]
UInt32Array = NDArray[np.uint32]
BoolArray = NDArray[np.bool_]

_SHOWN = 4
"""Items of a list that a printed form shows."""
_SHOWN_LETTERS = 60
"""Letters of a value that a printed form shows."""

Index = int | slice | NDArray[np.integer] | BoolArray
"""An index of rows: a number, which takes one row, a slice, row numbers or a mask."""


def refuse_text(**given: object) -> None:
    """Raise `InputError` for a named value that is or contains text.

    NumPy would read "9.85" as a number, and other libraries fail in the middle of a calculation.
    """
    for name, value in given.items():
        if value is None or isinstance(value, float | int):
            continue
        values: list[object] = []
        with suppress(ValueError):  # Lists of uneven lengths are refused later.
            array = np.asarray(value)
            values = array.ravel().tolist() if array.dtype.kind in "SUO" else []
        for text in values:
            if isinstance(text, str | bytes):
                raise InputError(
                    f"{name} has the text {text!r:.40}; expected numbers: convert it by float()"
                )


def by_dimensions(*values: Any) -> list[Any]:
    """Return values, broadcast by the names of their dimensions, if any.

    By position, the two axes of a square raster would give the places of its diagonal. The
    dimensions of the last value come first, so that x and y make rows of y.
    """
    is_named = [bool(getattr(one, "dims", ())) and hasattr(one, "coords") for one in values]
    if sum(is_named) < 2:
        return list(values)
    xarray = library("xarray", "a DataArray")
    named = reversed(xarray.broadcast(*reversed([*compress(values, is_named)])))
    return [next(named) if by_name else one for one, by_name in zip(values, is_named, strict=True)]


class ShortRepr:
    """Base of dataclasses that print on one line, arrays as shapes.

    The dataclass needs ``repr=False``.
    """

    __slots__ = ()

    def __repr__(self) -> str:
        fields = cast(Any, self).__dataclass_fields__.values()
        names = [field.name for field in fields if field.repr]
        shown = ", ".join(f"{name}={_short(getattr(self, name))}" for name in names)
        return f"{type(self).__name__}({shown})"


def _short(value: object) -> str:
    """Return a value in a few words."""
    if isinstance(value, np.ndarray):
        return f"{value.shape} {value.dtype}"
    if isinstance(value, float):
        return f"{value:.7g}"
    if isinstance(value, tuple | list | Mapping) and len(value) > _SHOWN:
        return f"({len(value)} items)"
    text = repr(value)
    return text if len(text) <= _SHOWN_LETTERS else f"{text[:_SHOWN_LETTERS]}..."


class Rows(ShortRepr):
    """Base of dataclasses whose fields are arrays of one length.

    A field may also be other `Rows` of that length, or None.
    """

    __slots__ = ()

    def __len__(self) -> int:
        return len(getattr(self, self._names()[0]))

    def __iter__(self) -> Iterator[Self]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, index: Index) -> Self:
        if isinstance(index, int | np.integer):
            number = range(len(self))[index]
            index = slice(number, number + 1)
        columns = {
            name: None if column is None else column[index]
            for name, column in self.columns().items()
        }
        return type(self)(**columns)

    def columns(self) -> dict[str, Any]:
        """Return the fields by name."""
        return {name: getattr(self, name) for name in self._names()}

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Join rows in order; at least one part."""
        columns = {name: [getattr(part, name) for part in parts] for name in cls._names()}
        return cls(**{name: _concatenated(column) for name, column in columns.items()})

    def replaced(self, chosen: BoolArray, other: Self) -> Self:
        """Return the rows of ``other`` where ``chosen`` (M,), else these."""
        columns = {name: (getattr(other, name), old) for name, old in self.columns().items()}
        return type(self)(**{name: _chosen(chosen, *both) for name, both in columns.items()})

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        # `dataclasses.fields` would take a tenth of the time of a refinement.
        return tuple(cast(Any, cls).__dataclass_fields__)


def _chosen(chosen: BoolArray, new: Any, old: Any) -> Any:
    if old is None:
        return None
    if isinstance(old, Rows):
        return old.replaced(chosen, new)
    return np.where(chosen.reshape(-1, *[1] * (old.ndim - 1)), new, old)


def _concatenated(column: list[Any]) -> Any:
    first = column[0]
    if first is None:
        return None
    return type(first).concatenate(column) if isinstance(first, Rows) else np.concatenate(column)
