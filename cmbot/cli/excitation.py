"""The command that shakes: `cmbot excite`."""

from __future__ import annotations

import cmbot
from cmbot.cli.console import (
    ForceOption,
    JsonOption,
    PlanArgument,
    QuietOption,
    err,
    flat,
    out,
    print_result,
    print_table,
)
from cmbot.cli.views import claimed_plan

__all__ = ["excite"]


def excite(
    directory: PlanArgument,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Shake a plan's arm by trains, records or wind, as its scene says; add how its tool sways, and a page.

    Example: [bold]cmbot excite out/triangle[/bold]
    """
    from cmbot.archive import excitation_json, require_no_excitation
    from cmbot.excitation import PASSAGE_HEADINGS, excitation_rows, excitation_sentences, passage_rows

    with claimed_plan(directory) as plan:
        require_no_excitation(directory, force=force)
        if not quiet:
            err.show_sign("shaking …")
        excitation = cmbot.excite(plan)
        from cmbot.views import EXCITATION, excitation_page

        added = {EXCITATION: excitation_page(plan, excitation)}
        written = cmbot.save_excitation(excitation, directory, force=force, added=added)
    if as_json:
        print_result("excite", directory, excitation_json(excitation))
    elif not quiet:
        rows = list(excitation_rows(excitation))
        print_table(plan.scene.name, ("", ""), rows, text_columns=1)
        if passages := list(passage_rows(excitation)):
            print_table("Trains", PASSAGE_HEADINGS, passages, text_columns=0)
        for sentence in excitation_sentences(excitation):
            out.print(sentence)
        out.print(f"Written to {', '.join(map(flat, written))}.")
