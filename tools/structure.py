"""Holds the structure of the package to its limits: sizes, and what no code may do.

``tools/structure.toml`` has the value of every rule that may not be exceeded. ``--write`` lowers the values
to what is measured; it never raises one: that is done by hand, in a commit that says why.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIMITS = ROOT / "tools" / "structure.toml"
BY_PACKAGE = "code_lines_of"

_LONGEST_MODULE, _LONGEST_FUNCTION, _LONGEST_LINE = 800, 60, 200
# Parts of errors that tell people what was wrong: nothing may be decided by them.
_TOLD = {"reason", "quantity", "constraint", "expected", "got"}
# Packages below planning, which know nothing of the command line and of the planner's options.
_BELOW = ("common", "trajectory", "optimization", "robot", "elastic", "hold", "collision")
_COMMAND = re.compile(r"\bcmbot [a-z]+\b|(?<![\w-])--[a-z][a-z-]+|\bplanner\.[a-z_]+")
_CONSTANT = re.compile(r"_[A-Z][A-Z0-9_]*")
_CONTAINERS = {"dict", "list", "set", "defaultdict", "OrderedDict", "Counter", "deque"}
_OF_PRIVATE = re.compile(r"from cmbot[\w.]* import [^\n]*\b_[a-z]|monkeypatch\.setattr\([^\n]*[\"'.]_[a-z]")
_OF_ROBOT = re.compile(r"^\s*(from|import) cmbot\.(robot|scene)\b", re.MULTILINE)


class Module:
    """A module: its path in the checkout, its text and its syntax tree."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.text, self.tree = path, text, ast.parse(text)

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """Its syntax tree's nodes, breadth first."""
        return list(ast.walk(self.tree))

    @property
    def package(self) -> str:
        """The package below ``cmbot`` that it is in, or its own name at the top."""
        return self.path.parts[1].removesuffix(".py")

    @cached_property
    def documented(self) -> list[ast.Constant]:
        """Its docstrings, and all other text that is a statement of its own."""
        statements = (node.value for node in self.nodes if isinstance(node, ast.Expr))
        return [node for node in statements if isinstance(node, ast.Constant) and isinstance(node.value, str)]

    @cached_property
    def code_lines(self) -> set[int]:
        """Numbers of the lines that are neither docstrings, comments nor blank."""
        lines = enumerate(self.text.splitlines(), start=1)
        code = {n for n, line in lines if line.strip() and not line.strip().startswith("#")}
        for node in self.documented:
            code -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        return code


def modules_of(folder: str) -> list[Module]:
    """Return the modules below a folder of the checkout."""
    paths = sorted((ROOT / folder).rglob("*.py"))
    return [Module(path.relative_to(ROOT), path.read_text(encoding="utf-8")) for path in paths]


def functions_too_long(module: Module) -> Iterator[int]:
    """Yield lines of functions of more lines of code than one may have."""
    for node in module.nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            own = set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
            if len(own & module.code_lines) > _LONGEST_FUNCTION:
                yield node.lineno


def text_that_steers(module: Module) -> Iterator[int]:
    """Yield lines that decide by what an error tells people."""
    for node in module.nodes:
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            text = any(isinstance(side, ast.Constant) and isinstance(side.value, str) for side in sides)
            within = any(isinstance(operator, ast.In | ast.NotIn) for operator in node.ops)
            if (text or within) and any(map(_is_told, sides)):
                yield node.lineno
        elif (
            isinstance(node, ast.Attribute)
            and node.attr in ("startswith", "endswith")
            and _is_told(node.value)
        ):
            yield node.lineno


def _is_told(node: ast.expr) -> bool:
    """Whether an expression is text of an error: one of its attributes, or ``str(error)``."""
    if isinstance(node, ast.Attribute):
        return node.attr in _TOLD
    text = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "str"
    return text and any(word in ast.unparse(node) for word in ("error", "failure"))


def mutable_globals(module: Module) -> Iterator[int]:
    """Yield lines of containers in a module that are made empty, and so are there to be filled."""
    for node in module.tree.body:
        value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
        if isinstance(value, ast.Call):
            named = ast.unparse(value.func).partition("[")[0].rpartition(".")[2]
            if named in _CONTAINERS:
                yield node.lineno
        elif (isinstance(value, ast.Dict) and not value.keys) or (
            isinstance(value, ast.List) and not value.elts
        ):
            yield node.lineno


def scenes_as_data(module: Module) -> Iterator[int]:
    """Yield lines that take a scene's content as a dictionary, where scenes are neither read nor kept."""
    if module.package in ("scene", "archive"):
        return
    for node in module.nodes:
        if isinstance(node, ast.Attribute) and node.attr == "as_data":
            yield node.lineno


def past_the_checks(module: Module) -> Iterator[int]:
    """Yield lines that make or change a model of a file, a scene above all, without checking it."""
    for node in module.nodes:
        if isinstance(node, ast.Attribute) and node.attr in ("model_copy", "model_construct"):
            yield node.lineno
        elif isinstance(node, ast.Call) and node.args and ast.unparse(node.func).endswith("replace"):
            yield from [node.lineno] * ast.unparse(node.args[0]).rpartition(".")[2].endswith("scene")


def inner_exports(module: Module) -> Iterator[int]:
    """Yield lines that list what a module exports: names without an underscore say it."""
    if module.path.name != "__init__.py":
        for node in module.tree.body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                yield node.lineno


def commands_below_planning(module: Module) -> Iterator[int]:
    """Yield lines whose text names commands or options that packages below planning do not know."""
    if module.package not in _BELOW:
        return
    for node in module.nodes:
        if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
            continue
        if _COMMAND.search(node.value) and node not in module.documented:
            yield node.lineno


def private_constants(module: Module) -> Iterator[tuple[str, str]]:
    """Yield the private constants of a module that are numbers or text, with their values as text."""
    for node in module.tree.body:
        if not isinstance(node, ast.Assign):
            continue
        target, value = node.targets[0], node.value
        pairs = [(target, value)]
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts, strict=True))
        for name, given in pairs:
            plain = isinstance(given, ast.Constant | ast.UnaryOp | ast.BinOp)
            if plain and isinstance(name, ast.Name) and _CONSTANT.fullmatch(name.id):
                yield name.id, ast.unparse(given)


def constants_of_two_values(modules: Sequence[Module]) -> Iterator[str]:
    """Yield private constants that have different values in different modules."""
    values = defaultdict[str, set[str]](set)
    for module in modules:
        for name, value in private_constants(module):
            values[name].add(value)
    for name, own in sorted(values.items()):
        if len(own) > 1:
            yield f"{name}: {', '.join(sorted(own))}"


def lines_of_documents() -> Iterator[str]:
    """Yield lines of documents that are too long to be compared, but for those of tables."""
    for document in (*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md", ROOT / "CHANGELOG.md"):
        for number, line in enumerate(document.read_text(encoding="utf-8").splitlines(), start=1):
            if len(line) > _LONGEST_LINE and not line.startswith("|"):
                yield f"{document.relative_to(ROOT)}:{number}"


RULES: dict[str, Callable[[Module], Iterator[int]]] = {
    rule.__name__: rule
    for rule in (
        functions_too_long,
        text_that_steers,
        mutable_globals,
        scenes_as_data,
        past_the_checks,
        commands_below_planning,
        inner_exports,
    )
}
"""What no code may do, module by module."""


def measured() -> tuple[dict[str, int], dict[str, list[str]]]:
    """Return the value of every rule, and the places that make those that have some."""
    package, tests = modules_of("cmbot"), modules_of("tests")
    beside = [*tests, *modules_of("tools"), *modules_of("benchmarks"), *modules_of("studies")]
    sizes = Counter[str]()
    for module in package:
        sizes[f"{BY_PACKAGE}.{module.package}"] += len(module.code_lines)
    values = {
        "code_lines": sizes.total(),
        "files": len(package),
        "code_lines_beside": sum(len(module.code_lines) for module in beside),
        "modules_in_a_folder": max(Counter(module.path.parent for module in package).values()),
        "modules_too_long": sum(module.text.count("\n") > _LONGEST_MODULE for module in package),
    }
    places = {
        name: [f"{module.path}:{line}" for module in package for line in rule(module)]
        for name, rule in RULES.items()
    }
    places |= {
        "constants_of_two_values": list(constants_of_two_values(package)),
        "lines_of_documents": list(lines_of_documents()),
        "oracles_that_share_code": [
            str(each.path) for each in tests if "oracles" in each.path.parts and _OF_ROBOT.search(each.text)
        ],
        "tests_of_private_names": [str(each.path) for each in tests if _OF_PRIVATE.search(each.text)],
    }
    values |= {name: len(each) for name, each in places.items()}
    return values | sizes, places


def limits() -> dict[str, int]:
    """Return the value of every rule that may not be exceeded; those of packages by ``code_lines_of.``."""
    data = tomllib.loads(LIMITS.read_text(encoding="utf-8"))
    return {f"{BY_PACKAGE}.{name}": value for name, value in data.pop(BY_PACKAGE).items()} | data


def breaches(values: dict[str, int]) -> Iterator[str]:
    """Yield what is wrong with the values of the rules, in words."""
    allowed = limits()
    for rule, value in values.items():
        if rule not in allowed:
            yield f"{rule}: got no limit in {LIMITS.name}, expected one ({value} now)"
        elif value > allowed[rule]:
            yield f"{rule}: got {value}, expected at most {allowed[rule]}"
    for rule in sorted(allowed.keys() - values.keys()):
        yield f"{rule}: got a limit in {LIMITS.name}, expected none: there is nothing of that name"


def lower(values: dict[str, int]) -> None:
    """Write the values that are below their limits in place of these."""
    text, allowed = LIMITS.read_text(encoding="utf-8"), limits()
    for rule, value in values.items():
        if value < allowed.get(rule, value):
            name = rule.removeprefix(f"{BY_PACKAGE}.")
            text = re.sub(rf"^{re.escape(name)} = \d+", f"{name} = {value}", text, flags=re.MULTILINE)
    LIMITS.write_text(text, encoding="utf-8")


def main() -> int:
    """Compare with the limits, or lower them; the exit status is 1 where one is exceeded."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="lower the limits to what is measured")
    parser.add_argument("--show", metavar="RULE", help="print the places that make the value of a rule")
    given = parser.parse_args()
    values, places = measured()
    if given.show:
        print("\n".join(places.get(given.show, [str(values.get(given.show))])))
        return 0
    if given.write:
        lower(values)
    broken = list(breaches(values))
    for line in broken:
        print(f"{line}; tools/structure.py --show {line.partition(':')[0]}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
