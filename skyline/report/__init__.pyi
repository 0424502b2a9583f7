from .html import Page, Picture, Section, Table, Text
from .landscape import Landscape
from .match_report import report_matches, write_match_report
from .panorama_picture import (
    PanoramaView,
    count_names,
    draw_panorama,
    encode_panorama,
    picture_azimuths_deg,
)
from .peaks import Peaks, read_peaks
from .pictures import save_depth_images, save_depth_pictures
from .place_map import save_place_map
from .plan_maps import save_coverage_map
from .surroundings import Surroundings

__all__ = [
    "Landscape",
    "Page",
    "PanoramaView",
    "Peaks",
    "Picture",
    "Section",
    "Surroundings",
    "Table",
    "Text",
    "count_names",
    "draw_panorama",
    "encode_panorama",
    "picture_azimuths_deg",
    "read_peaks",
    "report_matches",
    "save_coverage_map",
    "save_depth_images",
    "save_depth_pictures",
    "save_place_map",
    "write_match_report",
]
