"""What a person sees: pictures, maps, pages that need no network, and GeoJSON."""

from skyline.report.html import Page, Picture, Section, Table, Text
from skyline.report.maps import Found, save_map
from skyline.report.matches import Matched, write_match_geojson, write_match_report
from skyline.report.peaks import Peaks, read_peaks
from skyline.report.pictures import save_depth_images, save_panorama
from skyline.report.surroundings import Surroundings

__all__ = [
    "Found",
    "Matched",
    "Page",
    "Peaks",
    "Picture",
    "Section",
    "Surroundings",
    "Table",
    "Text",
    "read_peaks",
    "save_depth_images",
    "save_map",
    "save_panorama",
    "write_match_geojson",
    "write_match_report",
]
