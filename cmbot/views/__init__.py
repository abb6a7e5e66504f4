"""What people see of a plan: the replay and the report as pages, the film, the plots.

What shows stances and walks is imported when it is first used: it needs the rooms that find them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cmbot.common.lazy_imports import on_first_use
from cmbot.views.compare import compare_page as compare_page, unlike as unlike
from cmbot.views.film import film as film
from cmbot.views.overview.gallery import gallery_page as gallery_page
from cmbot.views.page import assemble_plain as assemble_plain, write_page as write_page
from cmbot.views.plots import (
    figure_files as figure_files,
    plot as plot,
    require_matplotlib as require_matplotlib,
)
from cmbot.views.replay import ReplayServer as ReplayServer, replay as replay, replay_page as replay_page
from cmbot.views.report import (
    REPLAY as REPLAY,
    REPORT as REPORT,
    pages as pages,
    report as report,
    report_page as report_page,
)
from cmbot.views.show import show as show

if TYPE_CHECKING:
    from cmbot.views.overview.excitation import EXCITATION as EXCITATION, excitation_page as excitation_page
    from cmbot.views.overview.stances import stances_page as stances_page
    from cmbot.views.overview.walk import tour_page as tour_page, walk_page as walk_page
    from cmbot.views.walk_replay import walk_replay_page as walk_replay_page

__getattr__ = on_first_use(__name__)
