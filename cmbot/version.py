"""The version of the package, and of what its numbers depend on."""

from functools import cache

__version__ = "0.2.0"


def versions() -> dict[str, str]:
    """Return the versions of cmbot, Python and the packages that compute, by their names."""
    import platform

    packages = {name: _version_of(name) for name in ("numpy", "scipy", "pin", "coal")}
    return {"cmbot": __version__, "python": platform.python_version(), **packages}


@cache
def _version_of(package: str) -> str:
    from importlib import metadata

    return metadata.version(package)
