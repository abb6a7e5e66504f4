"""Jobs that end well, raise, abort and hang; and what is run again."""

import importlib
import json
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from cmbot.campaign import Job, JobResult, JobStatus, run_jobs
from cmbot.campaign.child import run_in_child
from cmbot.common.errors import InputError, MissingExtra

CALLS = "campaign_calls"


def job(name: str, call: str = "", **arguments: object) -> Job:
    return Job(name=name, function=f"{CALLS}:{call or name}", arguments=arguments, time_limit=60)


JOBS = (
    job("add", x=1, y=2),
    job("abort"),
    replace(job("hang"), time_limit=0.5),
    job("refuse", reason="no such\nthing"),
    job("exhaust"),
    job("leave"),
    job("nonsense", "not_there"),
)
ENDS = {
    "add": ("done", ""),
    "abort": ("crashed", "signal SIGABRT"),
    "hang": ("timed out", "killed after 0.5 s"),
    "refuse": ("raised", "ValueError: no such thing"),
    "exhaust": ("raised", "MemoryError: all of it"),
    "leave": ("crashed", "exit status 0 without an answer"),
    "nonsense": ("raised", f"AttributeError: module '{CALLS}' has no attribute 'not_there'"),
}


@pytest.mark.parametrize("each", JOBS, ids=lambda each: each.name)
def test_a_job_that_fails_costs_itself_alone(each: Job) -> None:
    result = run_in_child(each)
    assert (result.status, result.error) == ENDS[each.name]
    assert result.key == each.key
    assert result.value == (3 if each.name == "add" else None)
    assert result.details.startswith("Traceback") == (result.status == "raised")
    assert result.seconds > 0


def listening() -> set[str]:
    """Addresses on which this process and those that it started listen."""
    psutil = importlib.import_module("psutil")
    own, found = psutil.Process(), set[str]()
    for each in (own, *own.children(recursive=True)):
        # A job's process may have ended by now.
        with suppress(psutil.NoSuchProcess):
            sockets = each.net_connections("inet")
            found |= {one.laddr.ip for one in sockets if one.status == psutil.CONN_LISTEN}
    return found


def test_jobs_on_dask_are_resumed(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    # Starting it takes seconds, so once for all.
    jobs, seen, addresses = JOBS[:4], list[JobResult](), set[str]()

    def note(result: JobResult) -> None:
        seen.append(result)
        addresses.update(listening())

    first = run_jobs(jobs, tmp_path / "new", report=note)
    assert addresses == {"127.0.0.1"}
    assert [result.name for result in first] == [each.name for each in jobs]
    assert {result.name: (result.status, result.error) for result in first} == {
        each.name: ENDS[each.name] for each in jobs
    }
    assert sorted(result.name for result in seen) == sorted(each.name for each in jobs)
    assert not any(result.resumed for result in first)
    # No worker, and no dask, is needed where every result is there.
    again = run_jobs(jobs, tmp_path / "new")
    assert again == tuple(replace(result, resumed=True) for result in first)


def test_only_a_result_of_the_same_inputs_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module("cmbot.campaign.runner")
    ran = list[str]()

    def here(jobs: tuple[Job, ...], *_: object) -> list[JobResult]:
        ran.extend(each.name for each in jobs)
        return [JobResult(name=each.name, key=each.key, status=JobStatus.DONE, value=7) for each in jobs]

    monkeypatch.setattr(module, "_run", here)
    one, other = job("one", "add", x=1, y=1), job("other", "add", x=1, y=1)
    run_jobs([one, other], tmp_path)
    assert ran == ["one", "other"]
    (tmp_path / "other.json").write_text("{", encoding="utf-8")
    changed = replace(one, inputs={"scene": "0123"})
    assert [result.resumed for result in run_jobs([changed, other], tmp_path)] == [False, False]
    assert json.loads((tmp_path / "one.json").read_text(encoding="utf-8"))["key"] == changed.key
    assert [result.resumed for result in run_jobs([changed, other], tmp_path)] == [True, True]
    assert [result.resumed for result in run_jobs([changed], tmp_path, fresh=True)] == [False]
    # How long a job may take does not decide what it returns.
    assert replace(one, time_limit=1).key == one.key


def test_bad_jobs_and_a_missing_dask_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for key, value in (
        ("name", "../x"),
        ("function", "os.abort"),
        ("arguments", {"x": float("nan")}),
        ("time_limit", 0),
    ):
        with pytest.raises(InputError, match=f"Job: {key}: got"):
            replace(JOBS[0], **{key: value})
    with pytest.raises(InputError, match="several jobs named 'add', expected a unique name"):
        run_jobs([JOBS[0], JOBS[0]], tmp_path)
    with pytest.raises(InputError, match="workers: got 0"):
        run_jobs(JOBS[:1], tmp_path, workers=0)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtra, match=r"dask.distributed is not installed; run: pip install .*campaign"):
        run_jobs(JOBS[:1], tmp_path)
