"""Fuzz campaign: random mutants of all files that cmbot reads, and of command lines.

Each is read as cmbot reads it. It has to be accepted, or refused by one of cmbot's errors in one line of at
most 600 characters. Anything else is a finding: another exception, a crash, a hang, a warning, a figure that
is not finite. Findings are reduced, and saved with what reproduces them.

    python tools/fuzz.py --count 100000 --seed 7
    python tools/fuzz.py --seed 7 --only 4711
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from functools import partial
from pathlib import Path

from fuzzing.cases import KINDS, Case, make_case
from fuzzing.corpus import make_corpus
from fuzzing.reduction import reduced
from fuzzing.trials import Verdict
from fuzzing.workers import run_all
from threadpoolctl import threadpool_limits

_OUTCOMES = ("refused", "accepted")
# A line of progress after so many mutants.
_REPORT_EVERY = 5000
# Causes that are reduced and saved: more are only counted.
_MOST_SAVED = 40


def main() -> int:
    """Run a campaign, print its table, save its findings; 1 when there are any."""
    options = _options()
    began = time.monotonic()
    # The matrices are small.
    threadpool_limits(limits=1)
    shutil.rmtree(options.output / "findings", ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix="cmbot-fuzz-") as name:
        folder = Path(name)
        corpus = make_corpus(options.output / "corpus")
        make = partial(make_case, corpus, options.seed, options.kind)
        first = options.first
        indices = iter([options.only] if options.only is not None else range(first, first + options.count))
        started, until = time.monotonic(), began + 60 * options.minutes
        counts: Counter[tuple[str, str]] = Counter()
        findings: dict[tuple[str, str], list[tuple[Case, Verdict]]] = {}
        for case, verdict in run_all(make, indices, options.workers, folder, until):
            counts[case.kind, verdict.outcome] += 1
            if counts.total() % _REPORT_EVERY == 0:
                print(f"{counts.total()} mutants tried, {len(findings)} causes of findings", flush=True)
            if verdict.is_finding:
                alike = findings.setdefault(verdict.cause, [])
                alike.append((case, verdict))
                if len(alike) == 1:
                    line = f"{case.kind} {case.index}: {verdict.outcome}: {verdict.text} ({verdict.place})"
                    print(line, flush=True)
        seconds = time.monotonic() - started
        for number, alike in enumerate([*findings.values()][:_MOST_SAVED], start=1):
            _save(alike, options, folder, number)
    _print_table(counts, seconds)
    return 1 if findings else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=1000, help="number of mutants")
    parser.add_argument("--seed", type=int, default=0, help="of the random numbers")
    parser.add_argument("--kind", choices=KINDS, help="mutants of this kind alone")
    parser.add_argument("--first", type=int, default=0, help="index of the first mutant")
    parser.add_argument("--only", type=int, help="try the mutant of this index alone")
    parser.add_argument("--minutes", type=float, default=1e6, help="stop after this time")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="number of processes")
    parser.add_argument("--output", type=Path, default=Path("out/fuzz"), help="folder for findings")
    options = parser.parse_args()
    options.output = options.output.resolve()
    return options


def _save(alike: list[tuple[Case, Verdict]], options: argparse.Namespace, folder: Path, number: int) -> None:
    """Reduce the smallest finding of a cause, and write its files."""
    case, verdict = min(alike, key=lambda one: sum(map(len, one[0].files.values())))
    case = reduced(case, verdict, folder)
    target = options.output / "findings" / f"{number:02d}-{verdict.outcome.replace(' ', '_')}"
    target.mkdir(parents=True)
    for name, content in case.files.items():
        path = target / "files" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    about = {
        "outcome": verdict.outcome,
        "text": verdict.text,
        "place": verdict.place,
        "kind": case.kind,
        "words": case.words,
        "seed": options.seed,
        "indices": [each.index for each, _ in alike][:20],
        "times": len(alike),
    }
    (target / "about.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    print(f"{verdict.outcome}, {len(alike)} times: {target}")


def _print_table(counts: Counter[tuple[str, str]], seconds: float) -> None:
    rows = [("mutants", "tried", *_OUTCOMES, "findings")]
    rows += [(kind, *_numbers(counts, [kind])) for kind in KINDS]
    rows.append(("all", *_numbers(counts, KINDS)))
    for name, *numbers in rows:
        print(f"{name:<16}" + "".join(f"{number:>10}" for number in numbers))
    print(f"{counts.total() / max(seconds, 1e-9):.1f} mutants/s, {seconds:.0f} s")


def _numbers(counts: Counter[tuple[str, str]], kinds: Iterable[str]) -> list[str]:
    of_kinds = {key: number for key, number in counts.items() if key[0] in kinds}
    tried = sum(of_kinds.values())
    known = [sum(n for (_, outcome), n in of_kinds.items() if outcome == each) for each in _OUTCOMES]
    return [str(number) for number in (tried, *known, tried - sum(known))]


if __name__ == "__main__":
    sys.exit(main())
