"""The shipped scenes as one page: a picture of each, what it is about, and its command."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape

from cmbot.common.installation import picture_folder
from cmbot.views.page import still_page


def gallery_page(scenes: Mapping[str, tuple[str, str]]) -> str:
    """Return an HTML page that opens no connection and runs no script.

    Parameters
    ----------
    scenes : mapping of str to (str, str)
        By the name of each shipped scene what it is about, and the command for it. A scene without a picture
        is shown without one.
    """
    cards = "".join(_card(name, *words) for name, words in scenes.items())
    return still_page(
        "Scenes that come with cmbot",
        ["cmbot plan NAME plans one; cmbot doctor says where their files are."],
        f'<div class="pair">\n{cards}</div>',
    )


def _card(name: str, about: str, command: str) -> str:
    shown, path = escape(name), picture_folder() / f"{name}.png"
    picture = ""
    if path.is_file():
        data = base64.b64encode(path.read_bytes()).decode("ascii")
        picture = f'<img src="data:image/png;base64,{data}" alt="The arm at work">'
    words = f"<p>{escape(about)}</p><code>{escape(command)}</code>"
    return f"<section><h2>{shown}</h2>{picture}{words}</section>\n"
