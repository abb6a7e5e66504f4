"""Rewrites scene files of development versions, cmbot-scene/1, as cmbot-scene/2, which means the same."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

# What a scene of the first format meant by leaving it out.
_PROFILE = {"kind": "trapezoidal", "ramp": 0.2}
_JOINTS = "rigid"


def rewritten(data: Any) -> Any:
    """Return the content of such a scene in the second format; its order and comments stay."""
    data["format"] = "cmbot-scene/2"
    at = list(data).index("posture_deg")
    data.insert(at, "start", {"posture_deg": data.pop("posture_deg")})
    profile = data["tool_path"].setdefault("speed_profile", {})
    for key, value in _PROFILE.items():
        profile.setdefault(key, value)
    data.setdefault("robot", {}).setdefault("joints", _JOINTS)
    return data


def main() -> None:
    """Rewrite the files that are named, in place."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    yaml = YAML()
    yaml.preserve_quotes, yaml.width = True, 120
    yaml.indent(mapping=2, sequence=4, offset=2)
    for path in parser.parse_args().files:
        data = yaml.load(path.read_text(encoding="utf-8"))
        if data.get("format") != "cmbot-scene/1":
            print(f"{path}: format: got {data.get('format')}, expected cmbot-scene/1: it stays as it is")
            continue
        yaml.dump(rewritten(data), path)
        print(f"{path}: rewritten")


if __name__ == "__main__":
    main()
