"""``python -m cmbot``: the command line."""

from cmbot.cli import main

main()
