"""Commands as frozen dataclasses: their fields are the options, their docstring is the help."""

from __future__ import annotations

import argparse
import os
import re
from abc import ABC, abstractmethod
from argparse import SUPPRESS, ArgumentTypeError
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import partial
from inspect import cleandoc
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar, Literal, NoReturn, TypeVar, get_args, get_origin, get_type_hints

import cmbot
from cmbot.cli.console import ConsoleProgress, ExitStatus, err, out, print_json, scenes_named
from cmbot.common.errors import InputError, one_line
from cmbot.common.reading.input_files import is_folder

T = TypeVar("T")
C = TypeVar("C", bound="Command")

_TYPE_PHRASES: dict[type, str] = {int: "a whole number", float: "a number", Path: "a path", str: "text"}


class UsageError(Exception):
    """A command line that is wrong; `command` is what has been called."""

    def __init__(self, message: str, command: str = "cmbot") -> None:
        super().__init__(message)
        self.command = command


def argument(help: str, metavar: str, *, complete: Callable[[str], list[str]] | None = None) -> Any:
    """Declare an argument; a tuple is one or more of them. `complete` tells a shell what it may be."""
    return field(metadata={"help": help, "metavar": metavar, "complete": complete})


def option(
    default: object,
    help: str,
    *flags: str,
    metavar: str | None = None,
    least: float | None = None,
    most: float | None = None,
    instead: Callable[[], None] | None = None,
    needs: Sequence[str] = (),
    alone: str = "",
) -> Any:
    """Declare an option, called as its field is; without a default, `MISSING`, it is needed.

    A number has to be from `least` to `most`. Where it is given, `instead` is called in place of the command.
    It `needs` one of some other flags beside it, and of those that are `alone` by the same word one is given.
    """
    if needs:
        help = f"With {' or '.join(needs)}: {help}"
    told = {"help": help, "metavar": metavar, "least": least, "most": most, "instead": instead}
    return field(default=default, metadata={"flags": flags, "needs": needs, "alone": alone, **told})


@dataclass(frozen=True, kw_only=True)
class Command(ABC):
    """What is called, with its options."""

    reads: ClassVar[bool] = True
    """Whether it begins with imports and reading, which take up to a second."""

    @classmethod
    def verb(cls) -> str:
        """Return what the command is called."""
        return cls.__name__.removesuffix("Command").lower()

    def made(
        self, kind: type[T], prefix: str = "", called: Mapping[str, str] | None = None, **given: object
    ) -> T:
        """Return options whose fields are those of this command of the same names, and what is `given`.

        What is None is left as it is by default. Errors name the flags of this command, and those that are
        `called` otherwise.
        """
        from cmbot.common.reading.validation import validated

        names = {each.name: each.name.removeprefix(prefix) for each in fields(self)}
        known = {each.name for each in fields(kind)}  # type: ignore[arg-type]
        own = {name: getattr(self, field) for field, name in names.items() if name in known}
        values = {name: value for name, value in (own | given).items() if value is not None}
        if not hasattr(kind, "__pydantic_config__"):
            return kind(**values)
        flags = {names[each.name]: _flags(each)[0] for each in fields(self) if _flags(each)}
        with options_named(flags | dict(called or {})):
            return validated(kind, values, f"cmbot {self.verb()}", InputError)

    @abstractmethod
    def __call__(self) -> int | None:
        """Do what is asked; return the exit status, or None for 0."""


@dataclass(frozen=True, kw_only=True)
class Reporting(Command):
    """A command whose answer is tables and sentences, or one JSON object."""

    json: bool = option(False, "Print one JSON object on standard output instead of tables.")
    quiet: bool = option(False, "Print nothing but errors (and JSON).", "--quiet", "-q")

    def answer(
        self,
        data: Callable[[], Mapping[str, Any]],
        say: Callable[[], object],
        directory: Path | None = None,
    ) -> None:
        """Print what was found, or what was written into a folder, in the way that is asked for."""
        if self.json:
            where: dict[str, Any] = {}
            if directory is not None:
                files = sorted(path.name for path in directory.iterdir())
                where = {"directory": str(directory), "files": files}
            print_json({"verb": self.verb(), **where, **data()})
        elif not self.quiet:
            say()

    def wrote(self, file: Path, how: str = "", **told: object) -> None:
        """Say that a file was written, and how."""
        said = f"Written to {one_line(file)}{how}."
        self.answer(lambda: {"files": [str(file)], **told}, lambda: out.print(said))

    def work_in(
        self,
        directory: Path,
        require: Callable[[], object],
        work: Callable[[ConsoleProgress], T],
        write: Callable[[T], object],
        scenes: Sequence[str] = (),
    ) -> T:
        """Claim a folder, require that it may be written, do the work, show how far it is, and write.

        An error about work without a plan names the `scenes` as they were called.
        """
        with cmbot.archive.claim(directory):
            require()
            with scenes_named(*scenes), ConsoleProgress(quiet=self.quiet) as progress:
                found = work(progress)
            if not self.quiet:
                err.show_sign("writing …")
            write(found)
        return found


@contextmanager
def options_named(names: Mapping[str, str], command: str = "") -> Iterator[None]:
    """Name in an error an option of the command line in place of the key that it sets, and the command."""
    try:
        yield
    except InputError as error:
        key, expected = error.key.partition("[")[0], error.expected
        if key not in names:
            raise
        for name, flag in names.items():
            expected = expected.replace(name, flag)
        raise InputError(command or error.source, names[key], error.got, expected, error.choices) from error


@dataclass(frozen=True, kw_only=True)
class Writing(Reporting):
    """A command that writes what may be there already."""

    force: bool = option(False, "Replace what is there.")

    def absent(self, directory: Path, names: Sequence[str]) -> Callable[[], None]:
        """Return what refuses a folder that has files of some names, unless they may be replaced."""
        return lambda: cmbot.archive.require_absent(directory, names, force=self.force)

    def write(
        self, file: Path, text: str, data: Callable[[], Mapping[str, Any]], say: Callable[[], object]
    ) -> None:
        """Write a new file, and print what was found in the way that is asked for."""
        require_new(file, self.force)
        cmbot.archive.write_file(file, text.encode())
        self.answer(lambda: {"file": str(file), **data()}, say)


def require_new(path: Path, force: bool) -> None:
    """Refuse a file to write that is there already, unless it may be replaced, and a folder always."""
    # Those of Path raise for names that no file can have.
    if is_folder(path):
        raise InputError(str(path), "", "a folder", "the path of a file to write")
    if os.path.exists(path) and not force:  # noqa: PTH110
        raise InputError(str(path), "", "a file that is already there", "a new file, or --force")


class _Parser(argparse.ArgumentParser):
    """Reads the words of a command; what is wrong is raised."""

    def __init__(self, kind: type[Command]) -> None:
        # A paragraph is a line, which the terminal breaks.
        description = re.sub(r"(?<!\n)\n(?!\n)", " ", cleandoc(kind.__doc__ or ""))
        super().__init__(
            prog=f"cmbot {kind.verb()}",
            description=description,
            formatter_class=_HelpFormatter,
            allow_abbrev=False,
            add_help=False,
            argument_default=SUPPRESS,
        )
        # By itself it would take -1e-3 for an option.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        raise UsageError(message.removeprefix("argument "), self.prog)


class _HelpFormatter(argparse.HelpFormatter):
    """Help as wide as the terminal, with its paragraphs."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=30, width=min(out.width, 110))

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return "\n\n".join(
            super(_HelpFormatter, self)._fill_text(part, width, indent) for part in text.split("\n\n")
        )


class _Instead(argparse.Action):
    """An option in whose place something else is done, whatever other words there are."""

    def __init__(self, option_strings: Sequence[str], dest: str, **options: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, **options)

    def __call__(self, *_: object) -> NoReturn:
        self.const()
        raise SystemExit(ExitStatus.DONE)


def parsed(kind: type[C], words: Sequence[str]) -> C:
    """Return a command with the options that the words have.

    Raises
    ------
    UsageError
        When the words do not fit.
    InputError
        When options do not go together.
    SystemExit
        After an option in whose place something else was done, such as the help.
    """
    parser = parser_of(kind)
    given, others = parser.parse_known_intermixed_args(list(words))
    if others:
        parser.error(_unknown(others[0], flags_of(kind)))
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in vars(given).items()}
    _require_fitting(kind, values)
    return kind(**values)


def _require_fitting(kind: type[Command], given: Mapping[str, Any]) -> None:
    """Refuse options that do not go together: an `InputError` names them."""
    options = {_flags(each)[0]: each for each in fields(kind) if each.name in given and _flags(each)}
    alone: dict[str, list[str]] = {}
    for flag, declared in options.items():
        needs, value = declared.metadata["needs"], given[declared.name]
        if needs and not options.keys() & set(needs):
            got = "nothing beside it" if value is True else str(value)
            raise InputError(f"cmbot {kind.verb()}", flag, got, f"it with {' or '.join(needs)}")
        alone.setdefault(declared.metadata["alone"], []).append(flag)
    for word, flags in alone.items():
        if word and len(flags) > 1:
            got = "both" if len(flags) == 2 else "all"
            raise InputError(f"cmbot {kind.verb()}", ", ".join(flags), got, "one of them")


def _unknown(word: str, flags: Sequence[str]) -> str:
    from cmbot.common.reading.validation import hint

    if word.startswith("-"):
        return f"no such option: {one_line(word)}{hint(word, flags)}"
    return f"unexpected argument: {one_line(word)}"


def parser_of(kind: type[Command]) -> argparse.ArgumentParser:
    """Return what reads a command's words."""
    parser, hints = _Parser(kind), get_type_hints(kind)
    for declared in _ordered(kind):
        _add(parser, declared, hints[declared.name])
    parser.add_argument(
        "--help",
        action=_Instead,
        const=lambda: out.print(parser.format_help(), end=""),
        help="Show this help, and stop.",
    )
    return parser


def _ordered(kind: type[Command]) -> Iterator[Field[Any]]:
    """The fields of a command: its own, then those that it shares with others."""
    shared = {
        each.name for base in kind.__mro__[1:] for each in getattr(base, "__dataclass_fields__", {}).values()
    }
    yield from sorted(fields(kind), key=lambda each: each.name in shared)


def flags_of(kind: type[Command]) -> tuple[str, ...]:
    """Return what the options of a command are called."""
    return (*(flag for each in fields(kind) for flag in _flags(each)), "--help")


def _flags(declared: Field[Any]) -> tuple[str, ...]:
    """What an option is called; an argument has no such name."""
    if "flags" not in declared.metadata:
        return ()
    return declared.metadata["flags"] or (f"--{declared.name.replace('_', '-')}",)


def _add(parser: argparse.ArgumentParser, declared: Field[Any], hint: Any) -> None:
    told, flags = declared.metadata, _flags(declared)
    name: dict[str, Any] = {"dest": declared.name, "help": _help(declared)}
    if told.get("instead"):
        parser.add_argument(*flags, **name, action=_Instead, const=told["instead"])
        return
    # Where an option may be left out, its type is one or None.
    kinds = get_args(hint)
    kind = next(each for each in kinds if each is not NoneType) if NoneType in kinds else hint
    if kind is bool:
        parser.add_argument(*flags, **name, action="store_true")
        return
    settings: dict[str, Any] = {"metavar": told["metavar"] or declared.name.upper()}
    if get_origin(kind) is tuple:
        kind, *others = get_args(kind)
        if others != [Ellipsis]:
            settings |= {"nargs": 1 + len(others), "metavar": tuple(settings["metavar"].split())}
        elif flags:
            settings["action"] = "append"
        else:
            settings["nargs"] = "+"
    if get_origin(kind) is Literal:
        settings["type"] = partial(_known, choices=get_args(kind))
    else:
        settings["type"] = _converter(kind, told.get("least"), told.get("most"))
    if flags:
        settings["required"] = declared.default is MISSING
    parser.add_argument(*flags, **name, **settings)


def _help(declared: Field[Any]) -> str:
    text, default = declared.metadata["help"], declared.default
    shown = (
        f" [default: {default}]"
        if isinstance(default, int | float | str | Path) and default is not False
        else ""
    )
    return f"{text}{shown}".replace("%", "%%")


def _known(word: str, choices: Sequence[str]) -> str:
    if word not in choices:
        known = ", ".join(choices)
        raise ArgumentTypeError(f"got {one_line(word)}, expected a known value (one of: {known})")
    return word


def _converter(kind: type, least: float | None, most: float | None) -> Callable[[str], Any]:
    """What makes a value of a word."""
    bounds = [f"at least {least:g}"] if least is not None else []
    bounds += [f"at most {most:g}"] if most is not None else []
    expected = " of ".join(filter(None, (_TYPE_PHRASES[kind], " and ".join(bounds))))

    def converted(word: str) -> Any:
        try:
            value = kind(word)
        except ValueError:
            value = None
        inside = value is not None and (least is None or value >= least) and (most is None or value <= most)
        if not inside:
            raise ArgumentTypeError(f"got {one_line(word)}, expected {expected}")
        return value

    return converted
