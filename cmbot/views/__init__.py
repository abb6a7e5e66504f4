"""What people see of a plan."""

from cmbot.views.replay import replay, serve_replay
from cmbot.views.replay_page import replay_page
from cmbot.views.replay_server import ReplayServer

__all__ = ["ReplayServer", "replay", "replay_page", "serve_replay"]
