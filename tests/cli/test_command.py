"""Commands as dataclasses: what is read from words, and what is refused."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from cmbot.cli import COMMANDS
from cmbot.cli.command import Command, UsageError, argument, flags_of, option, parsed


@dataclass(frozen=True, kw_only=True)
class TryCommand(Command):
    """Try."""

    files: tuple[Path, ...] = argument("Files.", "FILE")
    at: tuple[float, float] | None = option(None, "A place.", metavar="X Y", most=10)
    count: int = option(1, "A number.", "--count", "-n", least=0)
    kind: Literal["a", "b"] | None = option(None, "A kind.")
    on: tuple[str, ...] = option((), "Names.")
    really: bool = option(False, "Whether.")

    def __call__(self) -> None: ...


def test_options_have_the_types_and_the_defaults_of_their_fields() -> None:
    assert parsed(TryCommand, ["x"]) == TryCommand(files=(Path("x"),))
    words = [
        *("x", "--at", "-1e-3", "-.5", "y", "-n", "2"),
        *("--on", "p", "--kind", "b", "--on=q", "--really"),
    ]
    assert parsed(TryCommand, [*words, "z"]) == TryCommand(
        files=(Path("x"), Path("y"), Path("z")),
        at=(-1e-3, -0.5),
        count=2,
        kind="b",
        on=("p", "q"),
        really=True,
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "the following arguments are required: FILE"),
        ("x --at 1", "--at: expected 2 arguments"),
        ("x --at 1 11", "--at: got 11, expected a number of at most 10"),
        ("x --at 1 nan", "--at: got nan, expected a number of at most 10"),
        ("x -n 1.5", "--count/-n: got 1.5, expected a whole number of at least 0"),
        ("x --kind c", r"--kind: got c, expected a known value \(one of: a, b\)"),
        ("x --realy", r"no such option: --realy; did you mean --really\?"),
        ("x --real", r"no such option: --real; did you mean --really\?"),
        ("x --really=yes", "--really: ignored explicit argument 'yes'"),
    ],
)
def test_what_is_wrong_is_named_by_its_option(words: str, message: str) -> None:
    with pytest.raises(UsageError, match=f"^{message}$") as caught:
        parsed(TryCommand, words.split())
    assert caught.value.command == "cmbot try"


@pytest.mark.parametrize("kind", COMMANDS.values(), ids=COMMANDS)
def test_every_command_has_help_with_an_example_and_all_its_options(
    kind: type[Command], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        parsed(kind, ["--help", "--nonsense"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert [flag for flag in flags_of(kind) if flag not in text] == []
    assert re.search(rf"\n\nExamples?: cmbot {kind.verb()}", text)
