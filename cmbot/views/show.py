"""A plan in a notebook: its replay page in a frame of the cell."""

from __future__ import annotations

from html import escape

from cmbot.common.errors import InputError
from cmbot.planning import Plan, require_plan
from cmbot.simulation import Tracking
from cmbot.views.replay import replay_page

_MIN_HEIGHT_PX, _MAX_HEIGHT_PX = 240, 4000  # px


def show(plan: Plan, *, tracking: Tracking | None = None, height: int = 560) -> Shown:
    """Show a plan in a notebook: its motions in 3-D, the torque over time and a slider.

    It is the page that `cmbot.replay` writes, in a frame, and needs no server and no network; it stays in
    the notebook's file, with about two megabytes.

    Parameters
    ----------
    plan : Plan
    tracking : Tracking, optional
        Of that plan: the tool of the elastic arm is then shown, too.
    height : int
        Of the frame, px.

    Returns
    -------
    Shown
        The last value of a cell is shown; elsewhere `IPython.display.display` shows it.

    Raises
    ------
    InputError
        When `plan` is none, `height` is out of its bounds, or `tracking` is that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.

    Examples
    --------
    >>> cmbot.show(plan, tracking=tracking)
    <...>
    """
    require_plan(plan, "cmbot.show")
    if (
        isinstance(height, bool)
        or not isinstance(height, int)
        or not _MIN_HEIGHT_PX <= height <= _MAX_HEIGHT_PX
    ):
        raise InputError(
            "cmbot.show", "height", height, f"a whole number from {_MIN_HEIGHT_PX} to {_MAX_HEIGHT_PX}"
        )
    return Shown(replay_page(plan, tracking), plan.scene.name, height)


class Shown:
    """A page that a notebook shows as the value of a cell.

    Parameters
    ----------
    page : str
        HTML.
    name : str
        What it shows.
    height : int
        px
    """

    def __init__(self, page: str, name: str, height: int) -> None:
        self.page = page
        self._name = name
        self._height = height

    def __repr__(self) -> str:
        return f"<the replay of {self._name}: shown in a notebook; cmbot.replay writes it to a file>"

    def _repr_html_(self) -> str:
        """The page in a frame that may run its scripts and save files, and has no access to the notebook."""
        return (
            f'<iframe srcdoc="{escape(self.page)}" sandbox="allow-scripts allow-downloads" '
            f'title="{escape(self._name)}" '
            f'style="width:100%;height:{self._height}px;border:0;border-radius:8px"></iframe>'
        )
