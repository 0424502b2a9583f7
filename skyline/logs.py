"""What a process tells on standard error: lines for a person, or JSON lines for a service."""

import json
import logging
import os
from datetime import UTC, datetime

ENVIRONMENT_VARIABLE = "SKYLINE_LOG"
JSON = "json"


class _JsonLines(logging.Formatter):
    """A record as one line of JSON; what `extra` holds under ``facts`` is in it too."""

    def format(self, record: logging.LogRecord) -> str:
        return json.dumps(
            {
                "time": datetime.fromtimestamp(record.created, UTC).isoformat(
                    timespec="milliseconds"
                ),
                "level": record.levelname.lower(),
                "message": record.getMessage(),
                **getattr(record, "facts", {}),
            }
        )


def as_json() -> bool:
    """Whether ``SKYLINE_LOG=json`` asks for JSON lines."""
    return os.environ.get(ENVIRONMENT_VARIABLE) == JSON


def start_logging() -> None:
    """Have what this process logs go to standard error; what GDAL and Python warn of too."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    # What GDAL cannot read becomes an error of one line; its own words on the way only confuse.
    logging.getLogger("rasterio").setLevel(logging.CRITICAL)
    if as_json():
        logging.captureWarnings(capture=True)
        logging.getLogger("skyline").setLevel(logging.INFO)
        for handler in logging.getLogger().handlers:
            handler.setFormatter(_JsonLines())
