"""Lists of photos: what each row says of its photo."""

from pathlib import Path

import pytest

from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.match.photo_lists import Entry, entries_of


def entries(folder: Path, projection: str) -> list[Entry]:
    """Return the entries of a list of one photo."""
    path = folder / "photos.csv"
    path.write_text(f"path,fov_deg,projection\nphoto.jpg,120,{projection}\n")
    return list(entries_of([path], Entry("", projection=Projection.CYLINDRICAL)))


def test_a_row_says_its_photo_s_projection(tmp_path):
    (entry,) = entries(tmp_path, "fisheye")
    assert (entry.projection, entry.fov_deg) == (Projection.FISHEYE, 120.0)


def test_a_row_without_a_projection_has_the_command_s(tmp_path):
    (entry,) = entries(tmp_path, "")
    assert entry.projection is Projection.CYLINDRICAL


def test_a_projection_that_is_none_is_refused_with_its_row(tmp_path):
    with pytest.raises(
        InputError, match=r"photos.csv.*projection is 'round'; expected perspective"
    ):
        entries(tmp_path, "round")
