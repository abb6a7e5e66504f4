"""What is found once in a process is kept for whoever asks the same again."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class Kept(Generic[T]):
    """Answers by what was asked; of more than `most` those asked for last."""

    def __init__(self, most: int) -> None:
        self._most, self._found = most, OrderedDict[Hashable, T]()

    def __call__(self, asked: Hashable, find: Callable[[], T]) -> T:
        if asked not in self._found:
            self._found[asked] = find()
            if len(self._found) > self._most:
                self._found.popitem(last=False)
        self._found.move_to_end(asked)
        return self._found[asked]
