"""A short fuzz campaign: what `make fuzz` does a hundred thousand times."""

import subprocess
import sys
from pathlib import Path

import pytest
from command_line import ROOT, environment
from fuzzing.cases import Case
from fuzzing.trials import try_case
from fuzzing.workers import run_all


def test_every_mutant_is_accepted_or_refused_in_one_line(tmp_path: Path) -> None:
    words = ("--count", "24", "--seed", "3", "--workers", "1", "--output", str(tmp_path))
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "fuzz.py", *words],
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout + done.stderr
    *_, total, rate = done.stdout.splitlines()
    name, tried, refused, accepted, findings = total.split()
    assert (name, int(tried), int(findings)) == ("all", 24, 0)
    assert min(int(refused), int(accepted)) > 5
    assert rate.endswith(" s")


START = "start: {posture_deg: [0]}"
SCENE = f"format: cmbot-scene/2\nname: x\n{START}\ntool_path: {{legs: [{{by: [1, 0, 0], seconds: 2}}]}}\n"
JUDGED = {
    "import os; os.abort()": ("crash", "exit status -6"),
    "while True: pass": ("hang", "for"),
    "raise KeyError('x')": ("untyped", "KeyError: 'x'"),
    "bytearray(1 << 33)": ("memory", "more than 4 GiB"),
    "import warnings; warnings.warn('x')": ("warning", "UserWarning: x"),
    "return float('nan')": ("not finite", " is not finite"),
    "return {'a': ['b nan m']}": ("not finite", ".a[0] is b nan"),
    "raise cmbot.InputError('f', '', 1, 'two')": ("refused", ""),
    "raise cmbot.SceneError.__base__.__base__('x')": ("refused", ""),
    "return 'finance: 1 Nm'": ("accepted", ""),
}


@pytest.mark.parametrize("code", JUDGED)
def test_what_a_campaign_looks_for_is_found(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    space: dict[str, object] = {}
    exec(f"import cmbot\ndef read(case):\n    {code}\n", space)
    monkeypatch.setattr("fuzzing.trials._read_scene", space["read"])
    if JUDGED[code][0] == "hang":  # all others end by themselves
        monkeypatch.setattr("fuzzing.workers._PATIENCE", 0.2)
    case = Case("scene", 0, {"scene.yaml": SCENE.encode()})
    ((_, verdict),) = run_all(lambda _: case, iter([0]), 1, tmp_path, float("inf"))
    outcome, text = JUDGED[code]
    assert verdict.outcome == outcome
    assert verdict.text.startswith(text)


@pytest.mark.parametrize(
    ("words", "outcome"),
    [
        (("check", "scene.yaml"), "refused"),
        (("--version",), "accepted"),
        (("--debug", "check", "nosuch"), "message"),
    ],
)
def test_a_command_line_is_judged_by_status_and_streams(
    words: tuple[str, ...], outcome: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert try_case(Case("command line", 0, {}, words), tmp_path).outcome == outcome


@pytest.mark.parametrize(("folder", "outcome"), [("nan", "accepted"), ("out", "not finite")])
def test_a_folder_may_be_called_like_no_number(
    folder: str, outcome: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def saved() -> None:
        sys.stdout.write("saved in nan")
        sys.exit(0)

    monkeypatch.setattr("fuzzing.trials.main", saved)
    assert try_case(Case("command line", 0, {}, ("plan", "-o", folder)), tmp_path).outcome == outcome
