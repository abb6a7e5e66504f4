"""The command that shakes: `cmbot excite`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cmbot
from cmbot.cli.command import Writing, argument
from cmbot.cli.console import err, out, print_table
from cmbot.cli.views import claimed_plan
from cmbot.common.errors import one_line


@dataclass(frozen=True, kw_only=True)
class ExciteCommand(Writing):
    """Shake a plan's arm by trains, records or wind, as its scene says; add how its tool sways, and a page.

    Example: cmbot excite out/triangle
    """

    directory: Path = argument("A plan directory.", "DIR")

    def __call__(self) -> None:
        from cmbot.archive import excitation_json, require_no_excitation
        from cmbot.excitation import PASSAGE_HEADINGS, excitation_rows, excitation_sentences, passage_rows

        directory = self.directory
        with claimed_plan(directory) as plan:
            require_no_excitation(directory, force=self.force)
            if not self.quiet:
                err.show_sign("shaking …")
            excitation = cmbot.excite(plan)
            from cmbot.views import EXCITATION, excitation_page

            added = {EXCITATION: excitation_page(plan, excitation)}
            written = cmbot.save_excitation(excitation, directory, force=self.force, added=added)

        def say() -> None:
            print_table(plan.scene.name, ("", ""), list(excitation_rows(excitation)), text_columns=1)
            if passages := list(passage_rows(excitation)):
                print_table("Trains", PASSAGE_HEADINGS, passages, text_columns=0)
            for sentence in excitation_sentences(excitation):
                out.print(sentence)
            out.print(f"Written to {', '.join(map(one_line, written))}.")

        self.answer(lambda: excitation_json(excitation), say, directory)
