"""What a process tells on standard error: lines for a person, or JSON lines for a service."""

import io
import json
import logging
import os
import sys
from datetime import UTC, datetime

from skyline.text import printable

ENVIRONMENT_VARIABLE = "SKYLINE_LOG"
JSON = "json"


class _Lines(logging.Formatter):
    """Formats a record's message as one line."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  (logging's name)
        record.message = printable(record.message)
        return super().formatMessage(record)


class _JsonLines(logging.Formatter):
    """Formats a record, and the facts that `extra` holds, as one line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        return json.dumps(
            {
                "time": datetime.fromtimestamp(record.created, UTC).isoformat(
                    timespec="milliseconds"
                ),
                "level": record.levelname.lower(),
                "message": printable(record.getMessage()),
                **getattr(record, "facts", {}),
            }
        )


def as_json() -> bool:
    """Whether ``SKYLINE_LOG=json`` asks for JSON lines."""
    return os.environ.get(ENVIRONMENT_VARIABLE) == JSON


def start_logging() -> None:
    """Send what this process logs to standard error, with what GDAL and Python warn of."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal whose encoding has no degree sign must not end the run.
            stream.reconfigure(errors="backslashreplace")
    handler = logging.StreamHandler()
    handler.setFormatter(_JsonLines() if as_json() else _Lines("%(levelname)s: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    # What GDAL cannot read becomes an error of one line; its own words on the way only confuse.
    logging.getLogger("rasterio").setLevel(logging.CRITICAL)
    if as_json():
        logging.captureWarnings(capture=True)
        logging.getLogger("skyline").setLevel(logging.INFO)
