"""Mutations of text, of nested data, of XML, of meshes, of NumPy archives."""

from __future__ import annotations

import copy
import io
import json
import math
import re
import zipfile
from collections.abc import Callable, Iterator
from random import Random
from typing import Any
from xml.etree import ElementTree

import numpy as np

__all__ = [
    "ODD_NUMBERS",
    "ODD_TEXTS",
    "by_structure",
    "mutate_data",
    "mutate_json",
    "mutate_npz",
    "mutate_text",
    "mutated_file",
    "several",
]

_LARGEST_SCALED = 1e300
ODD_NUMBERS: tuple[float, ...] = (
    *(0, -0.0, 1, -1, 2, 3, 7, 0.5, -0.5, 360, 1e-9, 1e-3, 1e3, 1e4, 1e6, 1e9, -1e4, -1e9),
    *(5e-324, 2.3e-308, 1e-300, 1e-154, 1e-16, 1e16, 1e100, 1e154, 1e155, 1e300, 1.7976931348623157e308),
    *(2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63, 2**64, 10**30, -(10**30), 10**400),
    *(math.inf, -math.inf, math.nan),
)
ODD_TEXTS = (
    *("", " ", "x", "cmbot", "triangle", "arm.urdf", "block.obj", "nosuch", ".", "..", "/", "~", "/dev/null"),
    *("\0", "a\0b", "é", "狗", "\u2028", "\ud800", "\x1b[31m", "\n", "a\nb", "[red]", "%s", "{}", "*a", "&a"),
    *("null", "true", "yes", "1e5", ".nan", "nan", "inf", "0x10", "1_000", "2001-01-01", "1:30", "٣", "1,5"),
    *("a" * 300, "a" * 10_000, "a.b" * 50, "[" * 200, "\u200b", "\ufeff", "’", "-", "--", "#"),
)
_ODD_BYTES = (
    *(b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\x1b[31m", b"\r", b"\t", b"\n---\n", b"\n...\n", b"%YAML 1.1\n"),
    *(
        b"&a ",
        b"*a ",
        b"!!python/object ",
        b"!x ",
        b"<<: ",
        b"? ",
        b"- ",
        b": ",
        b"{",
        b"}",
        b"[",
        b"]",
        b'"',
    ),
    *(
        b"'",
        b"|\n",
        b">\n",
        b"#",
        b",",
        b"-",
        b"nan",
        b".inf",
        b"1e999",
        b"<!-- ",
        b"<![CDATA[",
        b"&amp;",
        b"&x;",
    ),
    *(
        b"<!DOCTYPE a [<!ENTITY x 'y'>]>",
        b"\xed\xa0\x80",
        b"[" * 100,
        b"[" * 5000,
        b"{a: " * 300,
        b"- " * 500,
    ),
    *(b"9" * 5000, b"x" * 70_000, b"<a>" * 2000, b"\n" * 1000, "\u2028".encode(), "\u0085".encode()),
)
_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")

Change = Callable[[Random, bytes], bytes]


def several(rng: Random) -> int:
    """How many mutations: mostly one."""
    return 1 + (rng.random() < 0.3) + (rng.random() < 0.1) + 3 * (rng.random() < 0.03)


def mutate_text(rng: Random, text: bytes) -> bytes:
    """Return text with one change: cut, flipped, doubled, swapped, with odd bytes or another number in it."""
    if not text:
        return rng.choice(_ODD_BYTES)
    at = rng.randrange(len(text))
    to = min(len(text), at + int(rng.expovariate(1 / 30)) + 1)
    lines = text.split(b"\n")
    k, m = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(10):
        case 0:
            return text[:at]
        case 1:
            return text[:at] + bytes([text[at] ^ (1 << rng.randrange(8))]) + text[at + 1 :]
        case 2:
            return text[:at] + text[to:]
        case 3:
            return text[:to] + text[at:]
        case 4:
            return text[:at] + rng.choice(_ODD_BYTES) + text[at:]
        case 5 | 6:
            numbers = list(_NUMBER.finditer(text))
            if not numbers:
                return text[:at]
            start, end = rng.choice(numbers).span()
            return text[:start] + str(rng.choice(ODD_NUMBERS)).encode() + text[end:]
        case 7:
            lines[k], lines[m] = lines[m], lines[k]
        case 8:
            lines.insert(m, lines[k])
        case _:
            del lines[k]
    return b"\n".join(lines)


def mutate_data(rng: Random, data: Any) -> Any:
    """Return nested data with one change in it, anywhere."""
    places = list(_places(data))
    if not places:
        return _odd_value(rng, data)
    holder, key = rng.choice(places)
    value = holder[key]
    match rng.randrange(8):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, dict):
            name = rng.choice((str(key)[:-1], f"{key}s", f"{key}_m", str(key).upper(), *ODD_TEXTS))
            holder[name] = holder.pop(key) if rng.random() < 0.7 else copy.deepcopy(value)
        case 1:
            holder.insert(key, copy.deepcopy(value))
        case 2 if isinstance(value, list):
            holder[key] = value * rng.choice((0, 2, 2, 30, 300)) if len(value) < 1000 else value[:1]
        case 3:
            other, name = rng.choice(places)
            holder[key] = copy.deepcopy(other[name])
        case 4:
            for _ in range(rng.choice((1, 1, 2, 45, 55, 150))):
                value = [value] if rng.random() < 0.5 else {"a": value}
            holder[key] = value
        case _:
            holder[key] = _odd_value(rng, value)
    return data


def _places(data: Any) -> Iterator[tuple[Any, Any]]:
    """All holders and keys in nested data; of long lists of numbers, a few."""
    stack = [data]
    while stack:
        holder = stack.pop()
        if not isinstance(holder, dict | list):
            continue
        keys = list(holder) if isinstance(holder, dict) else list(range(min(len(holder), 20)))
        for key in keys:
            yield holder, key
            stack.append(holder[key])


def _odd_value(rng: Random, value: Any) -> Any:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # What is larger could not be scaled.
    if number and abs(value) < _LARGEST_SCALED and rng.random() < 0.75:
        scaled = value * rng.choice((-1, 0.1, 0.999, 1.001, 2, 10, 57.3, 1000, 1e6, 1e-6))
        return rng.choice((*ODD_NUMBERS, scaled, scaled, scaled, int(scaled), float(value)))
    return rng.choice(
        (
            None,
            True,
            False,
            [],
            {},
            [[]],
            {"a": 1},
            rng.choice(ODD_TEXTS),
            rng.choice(ODD_TEXTS),
            rng.choice(ODD_NUMBERS),
        )
    )


def mutated_file(rng: Random, name: str, content: bytes) -> bytes:
    """Return one of a robot's files, mutated by its structure or as text."""
    if name.endswith((".urdf", ".srdf")) and rng.random() < 0.7:
        return by_structure(_mutate_xml, rng, content)
    if name.endswith(".stl") and rng.random() < 0.6:
        return by_structure(_mutate_stl, rng, content)
    return mutate_text(rng, content)


def by_structure(change: Change, rng: Random, content: bytes) -> bytes:
    """Return a file changed by its structure, or as text where that has been broken before."""
    try:
        return change(rng, content)
    except Exception:  # noqa: BLE001  broken files break their readers in many ways
        return mutate_text(rng, content)


def _mutate_stl(rng: Random, content: bytes) -> bytes:
    numbers = np.frombuffer(content[84:], dtype=np.uint8).copy()
    facet = numbers.reshape(-1, 50)[rng.randrange(len(numbers) // 50)]
    odd = rng.choice((math.nan, math.inf, 1e30, 1e-30, 0.0, 3.4e38))
    facet[: 4 * rng.randrange(1, 13)].view("<f4")[-1:] = odd
    count = rng.choice((12, 12, 12, 0, 13, 2**31, 2**32 - 1))
    return content[:80] + count.to_bytes(4, "little") + numbers.tobytes()


def mutate_json(rng: Random, content: bytes) -> bytes:
    """Return a JSON file with one change in its data."""
    return json.dumps(mutate_data(rng, json.loads(content))).encode("utf-8", "surrogatepass")


def _mutate_xml(rng: Random, content: bytes) -> bytes:
    root = ElementTree.fromstring(content)
    element = rng.choice(list(root.iter()))
    parents = {child: parent for parent in root.iter() for child in parent}
    numbers = [(e, k) for e in root.iter() for k, v in e.attrib.items() if v[:1] in tuple("-0123456789")]
    match rng.randrange(9):
        case 0 if element in parents:
            parents[element].remove(element)
        case 1 if element in parents:
            parents[element].append(copy.deepcopy(element))
        case 2:
            element.tag = rng.choice(("robot", "link", "joint", "mesh", "x", "mimic", "transmission"))
        case 3 if element.attrib:
            del element.attrib[rng.choice(list(element.attrib))]
        case 4 if element.attrib:
            name = rng.choice(list(element.attrib))
            others = [e.get(name) for e in root.iter() if e.get(name)]
            texts = [text for text in ODD_TEXTS if text.isprintable()]
            element.set(name, rng.choice((rng.choice(texts), rng.choice(others))))
        case 5:
            for child in list(element):
                if rng.random() < 0.5:
                    element.remove(child)
                    rng.choice(list(root.iter())).append(child)
        case 6:
            element.text = rng.choice(("x", " ", "1 2 3"))
        case _ if numbers:
            chosen, name = rng.choice(numbers)
            words = chosen.get(name, "").split()
            words[rng.randrange(len(words))] = str(rng.choice(ODD_NUMBERS))
            chosen.set(name, " ".join(words))
    return ElementTree.tostring(root)


def mutate_npz(rng: Random, content: bytes) -> bytes:
    """Return a NumPy archive with one change in an array or in the archive."""
    arrays = dict(np.load(io.BytesIO(content)))
    name = rng.choice(sorted(arrays) or ["t"])
    array = arrays.get(name, np.zeros(3))
    file = io.BytesIO()
    match rng.randrange(9):
        case 0:
            arrays.pop(name, None)
        case 1:
            arrays[name] = array[..., : rng.randrange(1, 4)]
        case 2 if array.size:
            array.flat[rng.randrange(array.size)] = float(rng.choice(ODD_NUMBERS[:-10]))
        case 3 if array.size:
            array.flat[rng.randrange(array.size)] = rng.choice((math.nan, math.inf, -1e300))
        case 4:
            arrays[name] = array.astype(rng.choice(("f4", "i8", "c16", "U9", "O", "?", ">f8")))
        case 5:
            arrays[rng.choice(("u", "../q", "q.npy", "\0", "t" * 300))] = array
        case 6:
            np.savez_compressed(file, **{**arrays, name: np.zeros((rng.choice((10, 10**6)), 7))})
            return file.getvalue()
        case 7:
            shape = rng.choice(((10**9, 7), (-1,), (2**62, 2**62), (0,), (), (3, 0), (10**12,)))
            with zipfile.ZipFile(file, "w") as archive:
                head = str({"descr": "<f8", "fortran_order": False, "shape": shape}).encode() + b"\n"
                archive.writestr(f"{name}.npy", b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head)
            return file.getvalue()
        case _:
            arrays[name] = array.reshape(rng.choice(((-1,), (1, -1), (-1, 1), (1, 1, -1))))
    np.savez(file, **arrays)
    return file.getvalue()
