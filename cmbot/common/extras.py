"""How the optional packages are installed beside this cmbot."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

__all__ = ["DISTRIBUTION", "install_command"]

# The import name and the command are cmbot; that name is another project's on the package index.
DISTRIBUTION = "cmbot-planner"
_CHECKOUT = Path(__file__).resolve().parent.parent.parent


def install_command(extra: str) -> str:
    """Return the command that installs an extra: from the checkout where there is one, else by name.

    Parameters
    ----------
    extra : str
        Such as ``fast``.
    """
    if (_CHECKOUT / "pyproject.toml").is_file():
        return f"pip install -e {quote(f'{_CHECKOUT}[{extra}]')}"
    return f"pip install {quote(f'{DISTRIBUTION}[{extra}]')}"
