"""What the tasks of the campaign's tests call: in processes of their own."""

import os
import time


def add(x: int, y: int) -> int:
    return x + y


def abort() -> None:
    os.abort()


def hang() -> None:
    time.sleep(100)


def refuse(reason: str) -> None:
    raise ValueError(reason)


def exhaust() -> None:
    raise MemoryError("all of it")


def leave() -> None:
    os._exit(0)
