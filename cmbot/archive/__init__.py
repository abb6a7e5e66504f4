"""Plan directories: written whole or not at all, read back with every doubt spoken."""

from cmbot.archive.folder import add_file, require_free
from cmbot.archive.reading import load_plan
from cmbot.archive.writing import save

__all__ = ["add_file", "load_plan", "require_free", "save"]
