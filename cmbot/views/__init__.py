"""What people see of a plan: the replay and the report as pages, the film, the plots.

What shows stances and walks is imported when it is first used: it needs the rooms that find them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cmbot.common.lazy_imports import on_first_use
from cmbot.views.compare import compare_page
from cmbot.views.film import film
from cmbot.views.overview.gallery import gallery_page
from cmbot.views.page import assemble_plain, write_page
from cmbot.views.plots import figure_files, plot, require_matplotlib
from cmbot.views.replay import ReplayServer, replay, replay_page
from cmbot.views.report import REPLAY, REPORT, pages, report, report_page
from cmbot.views.show import Shown, show

if TYPE_CHECKING:
    from cmbot.views.overview.excitation import EXCITATION, excitation_page
    from cmbot.views.overview.stances import stances_page
    from cmbot.views.overview.walk import tour_page, walk_page
    from cmbot.views.walk_replay import walk_replay_page

__getattr__ = on_first_use(__name__)
