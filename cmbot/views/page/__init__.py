"""HTML pages: how they are put together, and their templates, scripts and styles, which lie here, too."""

from cmbot.views.page.assembly import (
    STAGE_SCRIPTS,
    assemble,
    assemble_plain,
    draft_of,
    pack,
    pack_exactly,
    still_page,
    table,
    ticks,
    write_page,
)

__all__ = [
    "STAGE_SCRIPTS",
    "assemble",
    "assemble_plain",
    "draft_of",
    "pack",
    "pack_exactly",
    "still_page",
    "table",
    "ticks",
    "write_page",
]
