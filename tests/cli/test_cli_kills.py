"""Calls that are killed at any step on the file system leave all or nothing, and the next one goes on."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import write_scene
from killed_calls import dies_at, is_refused_from
from plan_folders import names, with_baseline
from small_scenes import SHORT

import cmbot
import cmbot.views
from cmbot.archive import load_plan, load_tracking, plan_data, writing
from cmbot.archive.folder import read_folder
from cmbot.cli.planning import PlanCommand
from cmbot.cli.simulation import SimulateCommand
from cmbot.cli.views import ReportCommand
from cmbot.common.errors import ArchiveError
from cmbot.planning import Plan, Samples
from cmbot.simulation import Tracking

NOTES = "notes.txt"
TARGET = Path("work/plan")
# `make kills` tries all steps.
APART = int(os.environ.get("CMBOT_KILLS_APART", "2"))
PLANNED: dict[str, Any] = {"scene": "short.yaml", "output": TARGET, "quiet": True}
SIMULATED: dict[str, Any] = {"directory": TARGET, "quiet": True}
# What is called, and whether there is a plan directory before, and whether it has been simulated.
CALLS: dict[str, tuple[Callable[[bool], None], bool, bool]] = {
    "plan": (lambda force: PlanCommand(**PLANNED, force=force)(), False, False),
    "plan --force": (lambda _: PlanCommand(**PLANNED, force=True)(), True, True),
    "simulate": (lambda force: SimulateCommand(**SIMULATED, force=force)(), True, False),
    "simulate --force": (lambda _: SimulateCommand(**SIMULATED, force=True)(), True, True),
    "report": (lambda _: ReportCommand(directory=TARGET)(), True, True),
}


@pytest.fixture(scope="module")
def plans(short_plan: Plan) -> tuple[Plan, Plan]:
    """Two plans that differ, with few samples of the baseline."""

    def decimated(step: int) -> Plan:
        samples = short_plan.baseline.samples
        whole = {field.name: getattr(samples, field.name) for field in fields(samples)}
        few = {name: None if value is None else value[::step] for name, value in whole.items()}
        return with_baseline(short_plan, samples=Samples(**few))

    return decimated(200), decimated(100)


@pytest.fixture(scope="module")
def trackings(
    plans: tuple[Plan, Plan], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Tracking, Tracking]:
    """Two simulations that differ, with few samples, of the first plan as its files have it."""
    saved = tmp_path_factory.mktemp("saved") / "plan"
    cmbot.save(plans[0], saved)
    simulated = cmbot.simulate(load_plan(saved), progress=False)

    def scaled(factor: float) -> Tracking:
        motions = {}
        for name in ("baseline", "planned"):
            motion = getattr(simulated, name)
            few = {key: getattr(motion, key)[::20] for key in ("t", "error", "static", "path_error", "base")}
            motions[name] = replace(motion, **few | {"static": factor * few["static"]})
        return replace(simulated, **motions)

    return scaled(1.0), scaled(2.0)


def remembered(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that is computed once for each first argument."""
    results: dict[Any, Any] = {}

    def stand_in(first: Any, *others: Any) -> Any:
        key = first if isinstance(first, str) else id(first)
        if key not in results:
            results[key] = function(first, *others)
        return results[key]

    return stand_in


@pytest.fixture
def folder(
    plans: tuple[Plan, Plan],
    trackings: tuple[Tracking, Tracking],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Path:
    """The current folder, in which planning, simulation and pages take no time, and give what is new."""
    monkeypatch.chdir(tmp_path)
    scene = cmbot.load_scene(write_scene(tmp_path / "short.yaml", SHORT))
    pages = {f"{name}.html": f"<p>new {name}</p>".encode() for name in ("replay", "report")}
    for module, name, value in (
        (cmbot, "load_scene", lambda path: scene),
        (cmbot, "plan", lambda scene, options, partial, progress: plans[1]),
        (cmbot, "simulate", lambda plan, options, progress: trackings[1]),
        (cmbot, "load_plan", lambda directory: plans[0]),
        (cmbot, "load_tracking", lambda plan, directory: trackings[0]),
        (cmbot.views, "pages", lambda *_: pages),
        (cmbot.views, "report_page", lambda *_: "<p>new</p>"),
        (writing, "hashes_of", remembered(writing.hashes_of)),
        (writing, "samples_csv", remembered(writing.samples_csv)),
    ):
        monkeypatch.setattr(module, name, value)
    return tmp_path


def whole(folder: Path) -> dict[str, bytes] | None:
    """What a reader finds of the plan in a folder, if there is one."""
    try:
        _, contents = read_folder(folder, "plan.json", lambda hashes: hashes)
    except ArchiveError:
        return None
    return contents


# Ended at every other step.
@pytest.mark.parametrize("ends_at", [dies_at, is_refused_from])
@pytest.mark.parametrize("name", CALLS)
def test_a_kill_or_a_full_disk_leaves_the_old_or_the_new(
    folder: Path,
    plans: tuple[Plan, Plan],
    trackings: tuple[Tracking, Tracking],
    name: str,
    ends_at: Callable[[int, Callable[[], object]], bool],
) -> None:
    call, there, simulated = CALLS[name]
    before, work = folder / "before", folder / "work"
    before.mkdir()
    if there:
        cmbot.save(
            plans[0], before / "plan", added={"replay.html": "<p>old</p>", "report.html": "<p>old</p>"}
        )
        (before / "plan" / NOTES).write_text("mine", encoding="utf-8")
    if simulated:
        cmbot.save_tracking(trackings[0], before / "plan")
    shutil.copytree(before, work)
    call(False)
    old, new = whole(before / "plan"), whole(TARGET)
    assert old != new
    assert new is not None
    assert names(work) == {"plan"}
    seen = []
    for step in count(1, APART):
        shutil.rmtree(work)
        shutil.copytree(before, work)
        if not ends_at(step, lambda: call(False)):
            break
        state = whole(TARGET)
        assert state in (old, new)
        if state is not None:
            plan_data(TARGET)
        # The next call goes on with what was begun, or begins anew; with the same words where it may.
        call(True)
        assert whole(TARGET) == new
        assert names(TARGET) == {*new, "plan.json", *([NOTES] if there else [])}
        assert not there or (TARGET / NOTES).read_text(encoding="utf-8") == "mine"
        assert names(work) == {"plan"}
        seen.append(state)
    assert seen[0] == old
    # Once all is written a full disk is in nobody's way.
    assert seen[-1] == (new if ends_at is dies_at else old)
    tracking = load_tracking(load_plan(TARGET), TARGET)
    assert (tracking is None) == ("tracking.json" not in new)


def test_little_memory_is_told_in_one_line(tmp_path: Path) -> None:
    """Address space between what an interpreter and what a plan takes, each in a process of its own."""
    scene, target = write_scene(tmp_path / "short.yaml", SHORT), tmp_path / "plan"
    words = [sys.executable, "-m", "cmbot", "plan", scene, "-o", target, "--force", "--quiet"]
    ends = set()
    for megabytes in np.linspace(40, 640, 41 if APART == 1 else 5).round().astype(int).tolist():
        limit = 2 * (1_000_000 * megabytes,)
        done = subprocess.run(
            words,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
            preexec_fn=partial(resource.setrlimit, resource.RLIMIT_AS, limit),
        )
        ends.add(done.returncode)
        assert done.returncode in (0, 1)
        assert done.stderr.count("\n") == done.returncode, done.stderr
        assert "a bug in cmbot" not in done.stderr
        assert target.exists() == (done.returncode == 0)
        if target.exists():
            load_plan(target)
            shutil.rmtree(target)
        assert names(tmp_path) == {"short.yaml"}
    assert ends == {0, 1}
