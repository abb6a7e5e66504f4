"""What a shell may complete words to, and how a shell is made to ask for it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

from cmbot.cli.command import Command, UsageError, flags_of
from cmbot.cli.console import out
from cmbot.common.installation import shipped_scenes

ASKED = "_CMBOT_COMPLETE"
"""Environment variable that a shell sets when it asks for completions of its words."""

# Of every shell: the file that has its script, what is added to which other file, and the script.
_SHELLS = {
    "bash": (
        ".bash_completions/cmbot.sh",
        (".bashrc", "source ~/.bash_completions/cmbot.sh"),
        """_cmbot() {
    local IFS=$'\\n'
    COMPREPLY=( $(COMP_WORDS="${COMP_WORDS[*]}" COMP_CWORD=$COMP_CWORD _CMBOT_COMPLETE=1 "$1") )
}
complete -o default -F _cmbot cmbot
""",
    ),
    "zsh": (
        ".zfunc/_cmbot",
        (".zshrc", "fpath=(~/.zfunc $fpath); autoload -Uz compinit; compinit"),
        """#compdef cmbot
local found
found=(${(f)"$(COMP_WORDS="${words[*]}" COMP_CWORD=$((CURRENT - 1)) _CMBOT_COMPLETE=1 cmbot)"})
if (( $#found )); then compadd -- $found; else _files; fi
""",
    ),
    "fish": (
        ".config/fish/completions/cmbot.fish",
        None,
        """complete -c cmbot -a '(COMP_WORDS=(commandline -cp | string collect) \\
COMP_CWORD=(count (commandline -opc)) _CMBOT_COMPLETE=1 cmbot)'
""",
    ),
}


def complete_scene(begun: str) -> list[str]:
    """Return what a shell may complete a scene's name to: the shipped scenes, and files."""
    names = [*shipped_scenes()]
    folder, _, start = begun.rpartition("/")
    with suppress(OSError):
        found = (entry for entry in os.scandir(folder or ".") if entry.name.startswith(start))
        names += [
            f"{folder}/{entry.name}" if folder else entry.name
            for entry in found
            if entry.is_dir() or entry.name.endswith((".yaml", ".yml", ".json"))
        ]
    return sorted(name for name in names if name.startswith(begun))


def completions(commands: Mapping[str, type[Command]], environment: Mapping[str, str]) -> list[str]:
    """Return what the word may be completed to at which a shell's cursor is."""
    place = int(environment.get("COMP_CWORD", "0"))
    verb, *words = [*environment.get("COMP_WORDS", "").split(), "", ""][1 : place + 1] or [""]
    if not words:
        return sorted(name for name in commands if name.startswith(verb))
    if verb not in commands:
        return []
    if words[-1].startswith("-"):
        return [flag for flag in flags_of(commands[verb]) if flag.startswith(words[-1])]
    found = (each.metadata.get("complete") for each in fields(commands[verb]))
    complete = next(filter(None, found), None)
    return [] if complete is None else complete(words[-1])


def _shell() -> str:
    shell = Path(os.environ.get("SHELL", "")).name
    if shell not in _SHELLS:
        raise UsageError(f"the shell ($SHELL) is {shell or 'unknown'}, not one of {', '.join(_SHELLS)}")
    return shell


def script() -> None:
    """Print what makes the present shell complete words."""
    out.print(_SHELLS[_shell()][2], end="")


def install() -> None:
    """Make the present shell complete words, from its next start on."""
    place, other, text = _SHELLS[shell := _shell()]
    path = Path.home() / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    if other is not None:
        start, line = Path.home() / other[0], other[1]
        before = start.read_text(encoding="utf-8") if start.exists() else ""
        if line not in before:
            start.write_text(f"{before}\n{line}\n", encoding="utf-8")
    out.print(f"Completion of {shell} is in {path}; it begins with the next shell.")
