"""Whether advice does: scenes that are refused, planned again as the refusal says.

    python benchmarks/advice.py --seed 3607 --scenes 40 --output out/advice.json

Scenes are those of the suite's generator in a share of their seconds, drawn with the seed; those that are
planned nevertheless are left out. Where a refusal says what "would do" the scene is changed accordingly, and
planned. What was run is kept in the output, and not run again.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table
from suite.scenes import make_scene

import cmbot
from cmbot.common.errors import CmbotError

# Shares of the suite's seconds; longest time for a plan, s; scenes that are drawn for each that is wanted.
SHARES, LONGEST_S, DRAWN = (0.15, 0.6), 200.0, 10
_VALUE = re.compile(r"([\w.\[\]]+) ([\w.+-]+) instead of [\w.+-]+")


def followed(data: dict[str, Any], words: str) -> dict[str, Any]:
    """Return the data of a scene changed as a refusal says."""
    changed = json.loads(json.dumps(data))
    path = changed["tool_path"]
    if "seconds: auto on the legs" in words:
        path["legs"] = [_without_time(leg) for leg in path["legs"]]
        profile = re.search(r"speed_profile: ({.*?})", words)
        path |= {"seconds": "auto", "speed_profile": yaml.safe_load(profile[1])}  # type: ignore[index]
        return changed
    if found := re.search(r"every leg of tool_path.legs in ([\d.]+) times its seconds", words):
        for leg in path["legs"]:
            leg["seconds"] *= float(found[1])
        return changed
    values = _VALUE.findall(words)
    if not values:
        raise ValueError(f"an advice of another form: {words}")
    for key, value in values:
        at, names = changed, re.findall(r"\w+", key)
        for name in names[:-1]:
            at = at[int(name)] if name.isdigit() else at.setdefault(name, {})
        at[names[-1]] = float(value) if value[0].isdigit() else value
    return changed


def _without_time(leg: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in leg.items() if key not in ("seconds", "speed_m_s")}


def tried(seed: int, number: int) -> dict[str, Any]:
    """Plan a scene, and again as its refusal says; return what came of it."""
    with tempfile.TemporaryDirectory() as folder:
        make_scene(seed, number, folder)
        data = yaml.safe_load((Path(folder) / "scene.yaml").read_text(encoding="utf-8"))
        share = float(np.random.default_rng([seed, number, 1]).uniform(*SHARES))
        for leg in data["tool_path"]["legs"]:
            if "seconds" in leg:
                leg["seconds"] = round(share * leg["seconds"], 3)
        data["planner"] = {**data.get("planner", {}), "time_limit_s": LONGEST_S}
        refusal = _refusal(data, folder)
        row: dict[str, Any] = {"number": number, "refusal": refusal, "advice": "", "does": None}
        advice = [
            part for part in refusal.split("; ") if part.endswith("would do") or "would do, and" in part
        ]
        if advice:
            again = _refusal(followed(data, advice[-1]), folder)
            row |= {"advice": advice[-1], "does": not again, "again": again}
        return row


def _refusal(data: dict[str, Any], folder: str) -> str:
    """Why a scene is refused; empty where it is planned."""
    file = Path(folder) / "changed.yaml"
    file.write_text(json.dumps(data), encoding="utf-8")
    try:
        cmbot.plan(cmbot.load_scene(file), progress=False)
    except CmbotError as error:
        return str(error) or type(error).__name__
    return ""


def main(words: list[str] | None = None) -> int:
    """Try scenes until as many as are wanted are refused; return 0 where all advice does."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=3607)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--output", type=Path, default=Path("out/advice.json"))
    asked = parser.parse_args(words)
    rows: list[dict[str, Any]] = []
    if asked.output.exists():
        known = json.loads(asked.output.read_text(encoding="utf-8"))
        rows = known["rows"] if known["seed"] == asked.seed else []
    asked.output.parent.mkdir(parents=True, exist_ok=True)
    for number in range(len(rows), DRAWN * asked.scenes):
        if sum(bool(row["refusal"]) for row in rows) >= asked.scenes:
            break
        rows.append(tried(asked.seed, number))
        asked.output.write_text(json.dumps({"seed": asked.seed, "rows": rows}, indent=1), encoding="utf-8")
    refused = [row for row in rows if row["refusal"]]
    advised = [row for row in refused if row["advice"]]
    table = Table("scenes", "refused", "advised", "of these do", "without a reason")
    silent = sum(not re.search(r"\w+ \w+", row["refusal"]) for row in refused)
    does = sum(row["does"] for row in advised)
    table.add_row(*map(str, (len(rows), len(refused), len(advised), does, silent)))
    console = Console(width=170)
    console.print(table)
    for row in advised:
        if not row["does"]:
            console.print(f"{row['number']}: {row['advice']}: {row['again']}")
    return 0 if does == len(advised) and not silent else 1


if __name__ == "__main__":
    sys.exit(main())
