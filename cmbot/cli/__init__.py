"""The command line: the only place that prints or exits."""

from cmbot.cli.commands import app, main
from cmbot.cli.signals import take_signals

__all__ = ["app", "main", "take_signals"]
