"""Plan directories: written whole or not at all, checked when they are read."""

from cmbot.archive.folder import (
    add_file,
    claim,
    new_folder,
    require_absent,
    require_free,
    require_new_folder,
    write_file,
    write_files,
)
from cmbot.archive.motion_files import columns
from cmbot.archive.names import PLAN_FILE
from cmbot.archive.reading import load_plan, plan_data
from cmbot.archive.ros import export_mcap, export_ros_package
from cmbot.archive.strict_json import json_bytes
from cmbot.archive.tracking import load_tracking, require_no_tracking, save_tracking, tracking_json
from cmbot.archive.walks import WALK_FILE, load_walk
from cmbot.archive.writing import resolved_file, save

__all__ = [
    "PLAN_FILE",
    "WALK_FILE",
    "add_file",
    "claim",
    "columns",
    "export_mcap",
    "export_ros_package",
    "json_bytes",
    "load_plan",
    "load_tracking",
    "load_walk",
    "new_folder",
    "plan_data",
    "require_absent",
    "require_free",
    "require_new_folder",
    "require_no_tracking",
    "resolved_file",
    "save",
    "save_tracking",
    "tracking_json",
    "write_file",
    "write_files",
]
