"""The command line: the only place that prints or exits."""

from cmbot.cli.commands import COMMANDS, main
from cmbot.cli.console import take_signals

__all__ = ["COMMANDS", "main", "take_signals"]
