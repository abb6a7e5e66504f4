"""The command line: the only place that prints or exits."""

from cmbot.cli.commands import COMMANDS as COMMANDS, main as main
from cmbot.cli.console import take_signals as take_signals
