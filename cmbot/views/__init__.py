"""What people see of a plan."""

from cmbot.views.replay import replay, serve_replay
from cmbot.views.replay_page import replay_page
from cmbot.views.replay_server import ReplayServer
from cmbot.views.report import report
from cmbot.views.report_page import report_page

__all__ = ["ReplayServer", "replay", "replay_page", "report", "report_page", "serve_replay"]
