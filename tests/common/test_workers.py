"""Calls by other processes: their results, errors and ends."""

import multiprocessing
import os
import time
from pathlib import Path

import pytest

from cmbot.common.errors import CmbotError, SceneError
from cmbot.common.workers import Workers


def called(number: int, folder: Path | None = None) -> tuple[int, int]:
    if folder is not None:
        (folder / f"{number}").touch()
    return number, os.getpid()


def refused() -> None:
    raise SceneError("scene.yaml", "speed", 0, "more")


def slept(seconds: float, folder: Path) -> None:
    (folder / "begun").touch()
    time.sleep(seconds)
    (folder / "ended").touch()


@pytest.mark.parametrize("number", [1, 2])
def test_results_and_errors_are_those_of_the_calls(number: int) -> None:
    with Workers(number) as workers:
        calls = [workers.call(called, k) for k in range(5)]
        wrong = workers.call(refused)
        found = [call.result() for call in calls]
        assert [k for k, _ in found] == [0, 1, 2, 3, 4]
        assert all((process == os.getpid()) == (number == 1) for _, process in found)
        assert all(call.has_begun() for call in calls) == (number == 2)
        with pytest.raises(SceneError, match=r"^scene.yaml: speed: got 0, expected more$"):
            wrong.result()
    assert not multiprocessing.active_children()


def test_alone_what_nobody_asks_for_is_not_called(tmp_path: Path) -> None:
    with Workers(1) as workers:
        calls = [workers.call(called, k, tmp_path) for k in range(3)]
        calls[1].result()
    assert [path.name for path in tmp_path.iterdir()] == ["1"]


def test_a_call_ends_with_the_context(tmp_path: Path) -> None:
    with Workers(2) as workers:
        workers.call(slept, 3600.0, tmp_path)
        while not (tmp_path / "begun").exists():
            time.sleep(0.01)
    assert not multiprocessing.active_children()
    assert not (tmp_path / "ended").exists()


def test_a_process_that_ends_is_an_error() -> None:
    with Workers(2) as workers, pytest.raises(CmbotError, match="has ended before its call was done"):
        workers.call(os._exit, 1).result()
