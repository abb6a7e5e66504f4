"""A task of a campaign, and its result."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any

from pydantic import Field

from cmbot.common.errors import InputError, one_line
from cmbot.common.reading.validation import CheckedFields

_TASK_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._\-]{0,99}")
_FUNCTION_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


def require_task_name(name: str, source: str, key: str) -> None:
    """Refuse, with an `InputError`, a name that no task's file can have."""
    if not _TASK_NAME.fullmatch(name):
        expected = "1 to 100 letters, digits, ., - and _, beginning with a letter or digit"
        raise InputError(source, key, repr(name), expected)


class TaskStatus(StrEnum):
    """How a task ended."""

    DONE = "done"
    """The function returned."""
    RAISED = "raised"
    """The function raised an exception, `MemoryError` included."""
    CRASHED = "crashed"
    """A signal ended the process, or it exited without an answer."""
    TIMED_OUT = "timed out"
    """It was killed at its time limit."""


@dataclass(frozen=True, kw_only=True)
class Task(CheckedFields):
    """A call of a function in a process apart.

    Attributes
    ----------
    name : str
        Of the task and of its result file: letters, digits, ``.``, ``-`` and ``_``; unique in its campaign.
    function : str
        ``package.module:name`` of a function that a fresh process can import. It returns JSON data.
    arguments : mapping
        Keyword arguments of the function, as JSON data.
    unkeyed : mapping
        Further ones, on which the result does not depend: where it is written.
    inputs : mapping of str to str
        What else the result depends on, such as hashes of files by their names.
    time_limit : float, s
        Wall time after which the process is killed.
    memory_limit : int or None, byte
        Of the process's address space; what it asks for beyond that is refused.

    Raises
    ------
    InputError
        When the name or the function's name is not possible, the arguments are no JSON data, or a limit is
        not positive.
    """

    name: str
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    unkeyed: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    time_limit: Annotated[float, Field(gt=0)] = 600.0
    memory_limit: Annotated[int, Field(gt=0)] | None = None

    def _check(self) -> None:
        require_task_name(self.name, "Task", "name")
        if not _FUNCTION_NAME.fullmatch(self.function):
            raise InputError("Task", "function", repr(self.function), "package.module:name")
        try:
            json.dumps(dict(self.arguments), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InputError("Task", "arguments", f"no JSON data ({error})", "JSON data") from error

    @property
    def key(self) -> str:
        """SHA-256 (hexadecimal) of function, arguments and inputs: equal keys have equal results."""
        content = [self.function, dict(self.arguments), dict(self.inputs)]
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, kw_only=True)
class TaskResult:
    """What became of a task.

    Attributes
    ----------
    name, key : str
        Of the task.
    status : TaskStatus
    value : JSON data
        What the function returned; None where it did not.
    error : str
        One line: the exception, the signal, or the time limit; empty when done.
    details : str
        End of what the process wrote to standard error, with the traceback of an exception.
    seconds, cpu_seconds : float, s
        Wall time, and processor time of its process without imports; the second is 0 where it gave no answer.
    attempts : int
        How often it was tried.
    resumed : bool
        Read from its file, not run in this call.
    """

    name: str
    key: str
    status: TaskStatus
    value: Any = None
    error: str = ""
    details: str = ""
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    attempts: int = 1
    resumed: bool = False

    @property
    def worth_a_retry(self) -> bool:
        """Whether another attempt may end otherwise: it crashed, hung or found no memory."""
        if self.status is TaskStatus.RAISED:
            return self.error.startswith("MemoryError")
        return self.status is not TaskStatus.DONE

    def __post_init__(self) -> None:
        object.__setattr__(self, "status", TaskStatus(self.status))
        object.__setattr__(self, "error", one_line(self.error))
