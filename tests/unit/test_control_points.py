"""Poses from control points of made cameras, and their files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.ExifTags import Base
from scenes import candidate_at, field_of, fractal

from skyline.angles import angle_between_deg
from skyline.camera.projection import Projection
from skyline.errors import InputError, MissingFileError, OffMapError
from skyline.orientation.control_points import KnownCamera, PointErrors, fit_points
from skyline.orientation.point_files import ControlPoints, read_control_points, write_control_points
from skyline.photo.photo import read_photo
from skyline.photo.skyline import PhotoSkyline
from skyline.view.viewer import Viewer

WIDTH_PX, HEIGHT_PX = 1200, 800
FIELD = field_of(1000.0 + fractal(90, 100, 500.0, seed=4), 30.0)
VIEWER = Viewer(FIELD)
EXACT = PointErrors(pixel_sd_px=0.2, place_sd_m=0.2, height_sd_m=0.2)
PIXELS = np.array([(100, 480), (350, 520), (600, 470), (800, 530), (950, 500), (1100, 560)], float)
TRUE = replace(
    candidate_at(1400.0, -1300.0, 131.0, 3.0, -1.0, 59.0), distortion=0.005,
    eye_elevation_m=float(FIELD.height_at(easting_m=1400.0, northing_m=-1300.0)) + 40.0,
)  # fmt: skip


def photo_of(projection=Projection.PERSPECTIVE, fov_deg=60.0):
    unknown = np.full(WIDTH_PX, np.nan), np.zeros(WIDTH_PX)
    return PhotoSkyline(*unknown, WIDTH_PX, HEIGHT_PX, fov_deg, projection)


def points_of(pose=TRUE, pixels=PIXELS, wrong=None, photo=None, with_elevation=True):
    """Return what pixels show from a pose; one of them is marked 60 px beside."""
    view = VIEWER.ground_view(pose, photo or photo_of())
    found = view.points(*pixels.T)
    assert not found.is_sky.any()
    lon, lat = FIELD.frame.to_lonlat(found.easting_m, found.northing_m)
    # A ray may have passed a quarter of a pixel aside.
    back = view.pixels(found.easting_m, found.northing_m)
    marked = np.stack([back.column_px, back.row_px], axis=1)
    if wrong is not None:
        marked[wrong] += (60.0, 25.0)
    return ControlPoints(
        path=Path("p.csv"), names=tuple("ABCDEF"[: len(pixels)]), column_px=marked[:, 0],
        row_px=marked[:, 1], lon=lon, lat=lat,
        elevation_m=found.elevation_m if with_elevation else np.full(len(pixels), np.nan),
    )  # fmt: skip


def known_at(photo=None, **given):
    """Return a camera known to stand 30 m beside the true one, at its elevation."""
    lon, lat = map(float, FIELD.frame.to_lonlat(TRUE.easting_m + 30.0, TRUE.northing_m))
    given = {"elevation_m": TRUE.eye_elevation_m} | given
    return KnownCamera.at(
        VIEWER, photo or photo_of(), lon=lon, lat=lat, position_sd_m=50.0, **given
    )


def off_deg(found, pose=TRUE):
    return float(angle_between_deg(found.pose.grid_heading_deg, pose.grid_heading_deg))


def state_of(pose):
    """Return the unknowns of a pose's covariance."""
    angles = np.radians([pose.grid_heading_deg, pose.pitch_deg, pose.roll_deg])
    scale = np.log(np.tan(np.radians(pose.fov_deg) / 2.0))
    place = pose.easting_m, pose.northing_m, pose.eye_elevation_m
    return np.array([*place, *angles, scale, pose.distortion])


def moved(off, covariance):
    """Return the true pose moved by its unknowns, with their covariance."""
    state = state_of(TRUE) + off
    heading_deg, pitch_deg, roll_deg = np.degrees(state[3:6])
    return replace(
        TRUE, easting_m=state[0], northing_m=state[1], eye_elevation_m=state[2],
        heading_deg=heading_deg + TRUE.convergence_deg, pitch_deg=pitch_deg, roll_deg=roll_deg,
        fov_deg=2.0 * np.degrees(np.arctan(np.exp(state[6]))), distortion=state[7],
        covariance=tuple(map(tuple, covariance)),
    )  # fmt: skip


def test_points_give_the_place_the_attitude_and_the_lens():
    found = fit_points(VIEWER, photo_of(), points_of(), known_at(), EXACT)
    assert off_deg(found) < 0.05
    assert found.pose.distance_m(TRUE) < 3.0
    for name in ("pitch_deg", "roll_deg", "fov_deg"):
        assert getattr(found.pose, name) == pytest.approx(getattr(TRUE, name), abs=0.1)
    assert (found.wrong, found.refusal) == ((), None)
    assert np.abs(found.residual_px).max() < 0.5
    assert found.misfit < 1.0


@pytest.mark.parametrize("wrong", range(6))
def test_one_wrong_point_of_six_is_named_and_moves_nothing(wrong):
    found = fit_points(VIEWER, photo_of(), points_of(wrong=wrong), known_at(), EXACT)
    assert found.wrong == ("ABCDEF"[wrong],)
    assert off_deg(found) < 0.1
    # It appears where it should have been marked.
    np.testing.assert_allclose(found.residual_px[wrong], (-60.0, -25.0), atol=3.0)
    assert "wrong: left out" in found.to_text()
    assert [one["used"] for one in found.to_dict()["points"]].index(False) == wrong


def test_the_record_of_a_pose_by_points_has_the_form_of_its_photo():
    found = fit_points(VIEWER, photo_of(), points_of(), known_at(), EXACT)
    fisheye = replace(found.photo, projection=Projection.FISHEYE)
    record = replace(found, photo=fisheye).to_dict()
    size = {"width_px": fisheye.width_px, "height_px": fisheye.height_px}
    assert record.items() >= ({"projection": "fisheye"} | size).items()


def test_errors_are_those_that_the_covariance_says():
    """No unbiased estimate is better: the covariance is the inverse of the information."""
    rng = np.random.default_rng(3)
    before = np.diag([25.0, 25.0, 25.0, 1e-3, 1e-4, 1e-4, 1e-4, 1e-5])
    exact = points_of()
    squares = []
    for _ in range(20):
        off = rng.multivariate_normal(np.zeros(8), before)
        noise = rng.normal(0.0, 2.0, (2, 6))
        given = moved(off, before)
        points = replace(
            exact, column_px=exact.column_px + noise[0], row_px=exact.row_px + noise[1]
        )
        found = fit_points(
            VIEWER, photo_of(), points, KnownCamera.of_pose(given), replace(EXACT, pixel_sd_px=2.0)
        )
        error = state_of(found.pose) - state_of(TRUE)
        squares.append(error @ np.linalg.solve(np.array(found.pose.covariance), error))
    # Chi square of 8 unknowns: 8 in the mean, and of 20 photos give or take sqrt(16 / 20) = 0.9.
    assert np.mean(squares) == pytest.approx(8.0, abs=2.0)


def test_points_on_the_ground_need_no_elevation():
    points = points_of(with_elevation=False)
    found = fit_points(VIEWER, photo_of(), points, known_at(), replace(EXACT, height_sd_m=1.0))
    assert off_deg(found) < 0.1


def test_a_pose_is_refined_within_its_covariance():
    before = replace(
        TRUE, heading_deg=TRUE.heading_deg + 0.8, easting_m=TRUE.easting_m + 10.0, distortion=0.0,
        covariance=tuple(map(tuple, np.diag([400.0, 400.0, 25.0, 4e-4, 1e-4, 1e-4, 1e-3, 1e-3]))),
    )  # fmt: skip
    found = fit_points(VIEWER, photo_of(), points_of(), KnownCamera.of_pose(before), EXACT)
    assert off_deg(found) < 0.05
    assert np.sqrt(found.pose.covariance[3][3]) < 0.2 * 2e-2


def test_a_panorama_is_oriented_too():
    photo = photo_of(Projection.CYLINDRICAL, 120.0)
    pose = replace(TRUE, distortion=0.0, fov_deg=120.0, pitch_deg=1.0, roll_deg=0.5)
    points = points_of(pose, photo=photo)
    found = fit_points(VIEWER, photo, points, known_at(photo), EXACT)
    assert off_deg(found, pose) < 0.2


def test_too_few_points_and_points_off_the_map_are_refused():
    points = points_of()
    two = replace(
        points, names=("A", "B"), column_px=points.column_px[:2], row_px=points.row_px[:2],
        lon=points.lon[:2], lat=points.lat[:2], elevation_m=points.elevation_m[:2],
    )  # fmt: skip
    with pytest.raises(InputError):
        fit_points(VIEWER, photo_of(), two, known_at(), EXACT)
    off = replace(points, lat=points.lat + 1.0, elevation_m=np.full(6, np.nan))
    with pytest.raises(OffMapError):
        fit_points(VIEWER, photo_of(), off, known_at(), EXACT)


@pytest.mark.parametrize("share", [1.0 / 0.3048, 0.001])
def test_elevations_in_other_units_are_refused(share):
    points = points_of()
    other = replace(points, elevation_m=points.elevation_m * share)
    with pytest.raises(InputError, match=r"point A has the elevation .* expected metres above its"):
        fit_points(VIEWER, photo_of(), other, known_at(), EXACT)


def test_a_pose_that_points_do_not_fit_is_not_trusted():
    points = points_of()
    mixed = replace(
        points, row_px=points.row_px[::-1].copy(), column_px=points.column_px[::-1].copy()
    )
    assert fit_points(VIEWER, photo_of(), mixed, known_at(), EXACT).refusal


@pytest.fixture
def read(tmp_path):
    def read_as(name, text):
        (tmp_path / name).write_text(text, errors="surrogateescape")
        return read_control_points(tmp_path / name)

    return read_as


def test_points_in_csv(read):
    found = read(
        "p.csv",
        "name,column_px,row_px,lon,lat,elevation_m\nHut,10,20.5,9.8,46.7,1900\n,1,2,9,46,\n",
    )
    assert found.names == ("Hut", "2")
    assert (found.column_px[0], found.row_px[0]) == (10.0, 20.5)
    assert (found.lon[0], found.lat[0], found.elevation_m[0]) == (9.8, 46.7, 1900.0)
    assert np.isnan(found.elevation_m[1])


@pytest.mark.parametrize("pixel", ["source", "pixel"])
def test_points_of_qgis_count_from_the_corner_and_may_be_disabled(read, pixel):
    text = f"""#CRS: EPSG:32632
mapX,mapY,{pixel}X,{pixel}Y,enable,dX,dY,residual
500000,5094000,10.5,-20.5,1,0,0,0
500000,5094000,11,-21,0,0,0,0
500000,5094000,12,-22,0.0,0,0,0
"""
    found = read("p.points", text)
    assert len(found) == 1
    assert (found.column_px[0], found.row_px[0]) == (10.0, 20.0)
    np.testing.assert_allclose((found.lon[0], found.lat[0]), (9.0, 46.0), atol=0.01)


def test_points_of_qgis_in_a_photo_that_exif_turns_are_refused(read, tmp_path):
    """QGIS shows the lying pixels of a photo that was taken upright."""
    Image.new("RGB", (60, 40)).save(tmp_path / "lying.jpg", exif=orientation(6))
    Image.new("RGB", (40, 60)).save(tmp_path / "upright.jpg", exif=orientation(1))
    found = read("p.points", "#CRS: EPSG:4326\nmapX,mapY,sourceX,sourceY\n9,46,10.5,-20.5\n")
    turned, upright = (read_photo(tmp_path / name) for name in ("lying.jpg", "upright.jpg"))
    assert turned.rgb.shape == upright.rgb.shape == (60, 40, 3)
    assert found.of_qgis
    upright.check_upright(found.path)
    with pytest.raises(InputError, match=r"lying.jpg as its file stores it, and EXIF turns"):
        turned.check_upright(found.path)


def orientation(number):
    exif = Image.Exif()
    exif[Base.Orientation] = number
    return exif


@pytest.mark.parametrize("suffix", [".csv", ".points"])
def test_points_are_read_as_they_are_written(tmp_path, suffix):
    points = points_of(with_elevation=suffix == ".csv")
    path = tmp_path / f"p{suffix}"
    write_control_points(path, points, np.full((6, 2), 0.25), np.ones(6, dtype=bool))
    found = read_control_points(path)
    for name in ("column_px", "row_px", "lon", "lat", "elevation_m"):
        np.testing.assert_allclose(getattr(found, name), getattr(points, name), atol=1e-7)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("p.csv", "x,y\n1,2\n"),
        ("p.csv", "column_px,row_px,lon,lat,colour\n1,2,9,46,red\n"),
        ("p.csv", "column_px,row_px,lon,lat\n1,2,9,146\n"),
        ("p.points", "mapX,mapY,sourceX,sourceY,enable\n500000,5094000,1,-2,1\n"),
        ("p.points", "mapX,mapY,sourceX,sourceY,enable\n9,46,1,-2,FALSE\n"),
        ("p.points", "#CRS: EPSG:5773\nmapX,mapY,sourceX,sourceY\n9,46,1,-2\n"),
        ("p.points", "#CRS: IAU_2015:30100\nmapX,mapY,sourceX,sourceY\n9,46,1,-2\n"),
        ("p.points", "#CRS: nowhere\nmapX,mapY,sourceX,sourceY,enable\n9,46,1,-2,1\n"),
        ("p.points", "#CRS: EPSG\udcff\nmapX,mapY,sourceX,sourceY,enable\n9,46,1,-2,1\n"),
        ("p.txt", "column_px,row_px,lon,lat\n1,2,9,46\n"),
    ],
)
def test_files_that_are_no_points_are_refused(read, name, text):
    with pytest.raises(InputError):
        read(name, text)


def test_a_missing_file_of_points_is_told(tmp_path):
    with pytest.raises(MissingFileError):
        read_control_points(tmp_path / "none.csv")


def test_points_outside_the_photo_are_of_another(tmp_path):
    with pytest.raises(InputError):
        points_of().check_inside(tmp_path / "a.jpg", 1100, 800)
