"""Plan directories: written whole or not at all, read back with every doubt spoken."""

from cmbot.archive.folder import add_file, require_free, write_file
from cmbot.archive.reading import load_plan
from cmbot.archive.tracking import require_no_tracking, save_tracking, tracking_json
from cmbot.archive.tracking_reading import load_tracking
from cmbot.archive.writing import save

__all__ = [
    "add_file",
    "load_plan",
    "load_tracking",
    "require_free",
    "require_no_tracking",
    "save",
    "save_tracking",
    "tracking_json",
    "write_file",
]
