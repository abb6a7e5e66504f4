"""Plan directories: written whole or not at all, checked when they are read.

What reads is imported when it is first used: it needs the rooms that simulate and walk.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cmbot.archive.folder import claim, write_file
from cmbot.archive.places import (
    add_file,
    new_folder,
    record_of,
    require_absent,
    require_free,
    write_results,
)
from cmbot.archive.records import (
    EVALUATION_FILE,
    EXCITATION_FILE,
    PLAN_FILE,
    STANCES_FILE,
    TOUR_FILE,
    TRACKING_FILES,
    WALK_FILE,
    json_bytes,
)
from cmbot.archive.tables import columns, samples_csv
from cmbot.archive.writing import export_csv, save
from cmbot.common.lazy_imports import on_first_use

if TYPE_CHECKING:
    from cmbot.archive.reading import load_plan, plan_data
    from cmbot.archive.results import (
        excitation_json,
        load_excitation,
        load_tracking,
        save_excitation,
        save_tracking,
        tracking_json,
    )
    from cmbot.archive.ros import export_mcap, export_ros, export_ros_package
    from cmbot.archive.verification.folders import Asked, Verdict, VerifiedMotion, verified_motions
    from cmbot.archive.walks import TourPart, load_tour, load_walk

__getattr__ = on_first_use(__name__)
