"""Height fields as files that are read in a tenth of the time that cleaning and warping take."""

import io
import json
import zipfile
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from skyline.errors import InputError, MissingFileError
from skyline.files import write_whole
from skyline.geodesy import Frame
from skyline.terrain.heightfield import HeightField, Provenance

SUFFIX = ".terrain"


def save_field(field: HeightField, path: Path) -> None:
    """Write a height field with its frame and provenance; raises `InputError` as `write_whole`."""
    about = {"frame": field.frame.wkt, "provenance": asdict(field.provenance)}
    grid = (field.west_m, field.north_m, field.spacing_east_m, field.spacing_north_m)
    content = io.BytesIO()
    np.savez(content, heights_m=field.heights_m, grid=np.array(grid), about=json.dumps(about))
    write_whole(path, content.getvalue())


def read_field(path: Path) -> HeightField:
    """Return the height field that `save_field` wrote.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        It is damaged, or was not written by `save_field`.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
            heights_m, grid, about = held["heights_m"], held["grid"], json.loads(str(held["about"]))
        heights_m.setflags(write=False)  # handed over, so that the field need not copy it
        west_m, north_m, step_east_m, step_north_m = grid.tolist()
        frame = Frame(about["frame"])
        made = Provenance(**about["provenance"])
        made = replace(made, files=tuple(made.files))
        return HeightField(heights_m, west_m, north_m, step_east_m, step_north_m, frame, made)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path} does not exist; name the elevation files") from error
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path} holds no elevation model that skyline saved; remove it, or name the files"
        ) from error
