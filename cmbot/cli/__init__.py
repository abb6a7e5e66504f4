"""The command line: the only place that prints or exits."""

from cmbot.cli.commands import app, main

__all__ = ["app", "main"]
