"""Plan directories: written whole or not at all, checked when they are read.

What reads is imported when it is first used: it needs the rooms that simulate and walk.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cmbot.archive.folder import claim as claim, write_file as write_file
from cmbot.archive.places import (
    add_file as add_file,
    new_folder as new_folder,
    record_of as record_of,
    require_absent as require_absent,
    require_free as require_free,
    write_results as write_results,
)
from cmbot.archive.records import (
    EVALUATION_FILE as EVALUATION_FILE,
    EXCITATION_FILE as EXCITATION_FILE,
    PLAN_FILE as PLAN_FILE,
    STANCES_FILE as STANCES_FILE,
    TOUR_FILE as TOUR_FILE,
    TRACKING_FILES as TRACKING_FILES,
    WALK_FILE as WALK_FILE,
    json_bytes as json_bytes,
)
from cmbot.archive.tables import columns as columns, samples_csv as samples_csv
from cmbot.archive.writing import export_csv as export_csv, save as save
from cmbot.common.lazy_imports import on_first_use

if TYPE_CHECKING:
    from cmbot.archive.reading import load_plan as load_plan, plan_data as plan_data
    from cmbot.archive.results import (
        excitation_json as excitation_json,
        load_excitation as load_excitation,
        load_tracking as load_tracking,
        save_excitation as save_excitation,
        save_tracking as save_tracking,
        tracking_json as tracking_json,
    )
    from cmbot.archive.ros import (
        enough_points as enough_points,
        export_mcap as export_mcap,
        export_ros as export_ros,
        export_ros_package as export_ros_package,
    )
    from cmbot.archive.verification.folders import Asked as Asked, verified_motions as verified_motions
    from cmbot.archive.walks import load_tour as load_tour, load_walk as load_walk

__getattr__ = on_first_use(__name__)
