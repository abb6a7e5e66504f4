"""Lazy imports: names of a package that are imported when they are first used."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module


def on_first_use(
    package: str, modules: Mapping[str, Sequence[str]], submodules: Sequence[str] = ()
) -> Callable[[str], object]:
    """Return what a package's ``__getattr__`` is to be (PEP 562).

    Parameters
    ----------
    package : str
        Its ``__name__``.
    modules : mapping from str to sequence of str
        The modules that define the names. No name may be that of a module of the package itself, which would
        hide it.
    submodules : sequence of str
        Modules of the package itself that are imported when they are first used.
    """
    module_of = {name: module for module, names in modules.items() for name in names}

    def attribute(name: str) -> object:
        if name in submodules:
            return import_module(f"{package}.{name}")
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(module_of[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return attribute
