"""Folders that are not what was asked for, and folders that are, judged by ``cmbot verify DIR --scene FILE``.

    python benchmarks/run_forgeries.py out/forgeries [--only WORD] [--honest]

Each forgery is first proven wrong by the oracles of the tests. Exit status 1 where one is verified, where one
is not proven wrong, or where an honest folder is refused. Plans that were made stay in the output folder.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console

_TESTS = Path(__file__).resolve().parent.parent / "tests"
sys.path[:0] = [str(_TESTS), str(_TESTS / "helpers")]


def main() -> int:
    """Judge all folders, print a line each, and return the exit status."""
    # They need the tests' helpers.
    from command_line import run
    from forged.forgeries import FORGERIES, forged, planned
    from forged.scenes import BASES, HONEST, changed

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("output", type=Path)
    parser.add_argument("--only", default="", help="forgeries whose category or name has this")
    parser.add_argument("--honest", action="store_true", help="honest folders alone")
    arguments = parser.parse_args()
    console, failed = Console(highlight=False, soft_wrap=True), 0
    chosen = [] if arguments.honest else [each for each in FORGERIES if arguments.only in str(each)]
    for forgery in chosen:
        wrong, outcome, alone = forged(forgery, arguments.output)
        told = alone.out.startswith(("Judged by what the folder says", "Promised otherwise"))
        bad = not wrong or outcome.status == 0 or not (alone.status or told)
        failed += bad
        proof, said = "; ".join(wrong[:2]) or "NOT PROVEN", outcome.err.strip()[-160:] or "verified"
        console.print(f"{'FAILED' if bad else 'ok'} {forgery}: {proof} -> {outcome.status} {said}")
        first = (alone.out or alone.err[-100:]).splitlines()[0]
        console.print(f"    without --scene: {alone.status} {first}")
    honest = HONEST if arguments.honest or not arguments.only else ()
    for number, (base, changes) in enumerate(honest):
        folder = arguments.output / "honest" / str(number)
        outcome = run("verify", folder, "--scene", planned(changed(BASES[base], changes), folder))
        failed += outcome.status != 0
        mark = "FAILED" if outcome.status else "ok"
        console.print(f"{mark} honest {number} {base} {changes} {outcome.err.strip()[:200]}")
    console.print(f"{failed} failed of {len(chosen)} forgeries and {len(honest)} honest folders")
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
