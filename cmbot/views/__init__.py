"""What people see of a plan."""

from cmbot.views.film import film
from cmbot.views.pages import REPLAY, REPORT, pages
from cmbot.views.plots import figure_files, plot, require_matplotlib
from cmbot.views.replay import replay, serve_replay
from cmbot.views.replay_page import replay_page
from cmbot.views.replay_server import ReplayServer
from cmbot.views.report import report
from cmbot.views.report_page import report_page

__all__ = [
    "REPLAY",
    "REPORT",
    "ReplayServer",
    "figure_files",
    "film",
    "pages",
    "plot",
    "replay",
    "replay_page",
    "report",
    "report_page",
    "require_matplotlib",
    "serve_replay",
]
