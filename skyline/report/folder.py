"""The folder of a report, and the files that belong to it."""

import re
from pathlib import Path

from skyline.errors import InputError
from skyline.files.disk import REPORT_PAGE, is_own_page
from skyline.files.folders import check_folder

CANDIDATES = "matches.geojson"
_FILES = re.compile(rf"{REPORT_PAGE}|{CANDIDATES}|\d\d+-(overlay\.jpg|(map|detail)\.png)")


def check_report_folder(folder: Path) -> None:
    """Check that a report would replace only an earlier report's files.

    The page of a report has a mark; without it, no file belongs to an earlier report. Raises
    `InputError` as `check_folder`, and for a file that would be replaced.
    """
    check_folder(folder)
    if not folder.exists() or is_own_page(folder / REPORT_PAGE):
        return
    for path in sorted(folder.iterdir()):
        if _FILES.fullmatch(path.name):
            raise InputError(
                f"{path} would be replaced, and {folder} has no {REPORT_PAGE} that is marked as "
                "Skyline's; name another folder for the report"
            )
