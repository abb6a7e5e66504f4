"""A hook of mkdocs: formulas between dollar signs become MathML, which browsers draw without a script.

``$$`` on lines of their own enclose a displayed formula, ``$`...`$`` one within a sentence: as GitHub has it.
"""

from __future__ import annotations

import re
from typing import Any
from xml.etree.ElementTree import Element

from latex2mathml.converter import convert
from markdown import Extension, Markdown
from markdown.inlinepatterns import InlineProcessor
from markdown.preprocessors import Preprocessor

__all__ = ["MathExtension", "on_config"]

_DISPLAYED = re.compile(r"^\$\$\n(.+?)\n\$\$$", re.MULTILINE | re.DOTALL)


class _Displayed(Preprocessor):
    def run(self, lines: list[str]) -> list[str]:
        def stashed(found: re.Match[str]) -> str:
            formula = convert(found[1].strip(), display="block")
            block = self.md.htmlStash.store(f'<div class="formula">{formula}</div>')
            return f"\n{block}\n"

        return _DISPLAYED.sub(stashed, "\n".join(lines)).split("\n")


class _WithinText(InlineProcessor):
    def handleMatch(self, m: re.Match[str], data: str) -> tuple[Element | str, int, int]:  # noqa: N802
        return self.md.htmlStash.store(convert(m[1])), m.start(0), m.end(0)


class MathExtension(Extension):
    """Formulas of a Markdown page as MathML."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802
        """Register what finds formulas: before tables and code spans are read, after fenced code."""
        md.preprocessors.register(_Displayed(md), "displayed_formula", 24)
        md.inlinePatterns.register(_WithinText(r"\$`(.+?)`\$", md), "formula", 200)


def on_config(config: Any) -> Any:
    """Add the extension to the site's Markdown."""
    config.markdown_extensions.append(MathExtension())
    return config
