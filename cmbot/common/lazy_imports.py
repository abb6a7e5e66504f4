"""Lazy imports: names of a package that are imported when they are first used."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path


def on_first_use(package: str, submodules: Sequence[str] = ()) -> Callable[[str], object]:
    """Return what a package's ``__getattr__`` is to be (PEP 562).

    The names are those that it imports for type checkers, below ``if TYPE_CHECKING``.

    Parameters
    ----------
    package : str
        Its ``__name__``. No name may be that of a module of the package itself, which would hide it.
    submodules : sequence of str
        Modules of the package itself that are imported when they are first used.
    """

    @cache
    def module_of() -> dict[str, str | None]:
        blocks = (node for node in _source_of(package).body if isinstance(node, ast.If))
        imports = (node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom))
        return {name.name: node.module for node in imports for name in node.names}

    def attribute(name: str) -> object:
        if name in submodules:
            return import_module(f"{package}.{name}")
        if not (module := module_of().get(name)):
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(module), name)
        setattr(sys.modules[package], name, value)
        return value

    return attribute


def exported(package: str) -> list[str]:
    """Return the names that a package imports ``as`` they are called (PEP 484), its ``__all__``."""
    imports = (node for node in ast.walk(_source_of(package)) if isinstance(node, ast.ImportFrom))
    return sorted(name.name for node in imports for name in node.names if name.name == name.asname)


def _source_of(package: str) -> ast.Module:
    return ast.parse(Path(str(sys.modules[package].__file__)).read_text(encoding="utf-8"))
