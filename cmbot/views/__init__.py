"""What people see of a plan: the replay and the report as pages, the film, the plots."""

from cmbot.views.compare import compare_page
from cmbot.views.film import film
from cmbot.views.gallery import gallery_page
from cmbot.views.page import assemble_plain, write_page
from cmbot.views.plots import figure_files, plot, require_matplotlib
from cmbot.views.replay import ReplayServer, replay, replay_page
from cmbot.views.report import REPLAY, REPORT, pages, report, report_page
from cmbot.views.show import Shown, show
from cmbot.views.stances import stances_page
from cmbot.views.toured import tour_page
from cmbot.views.walk_replay import walk_replay_page
from cmbot.views.walked import walk_page

__all__ = [
    "REPLAY",
    "REPORT",
    "ReplayServer",
    "Shown",
    "assemble_plain",
    "compare_page",
    "figure_files",
    "film",
    "gallery_page",
    "pages",
    "plot",
    "replay",
    "replay_page",
    "report",
    "report_page",
    "require_matplotlib",
    "show",
    "stances_page",
    "tour_page",
    "walk_page",
    "walk_replay_page",
    "write_page",
]
