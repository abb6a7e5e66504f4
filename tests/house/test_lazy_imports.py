"""`import cmbot` is quick: what is heavy is loaded when it is first used."""

import ast
import inspect
import json
import platform
import re
import resource
import subprocess
import sys
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest
from command_line import ROOT, environment
from small_scenes import SHORT

import cmbot
from cmbot import archive, campaigns, collision, views

HEAVY = {"pinocchio", "coal", "numpy", "scipy", "meshcat", "trimesh", "yourdfpy", "pydantic", "rich"}
# What planning a scene without meshes and writing its pages can do without.
NOT_TO_PLAN = {"IPython", "matplotlib", "meshcat", "networkx", "requests", "selenium", "ssl", "tornado"}
NOT_TO_PLAN |= {"trimesh", "yourdfpy", "zmq"}
NOT_TO_PLAN |= {f"cmbot.{name}" for name in ("campaigns", "identification", "stances")}
NOT_TO_PLAN |= {f"scipy.{name}" for name in ("integrate", "ndimage", "signal", "stats")}


def printed_by(code: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def loaded_by(code: str, depth: int = 1) -> set[str]:
    """Modules that a fresh process has after `code`, the first `depth` parts of their names."""
    report = (
        "\nimport json, sys\n"
        f"loaded = {{'.'.join(name.split('.')[:{depth}]) for name in sys.modules}}\n"
        "print('\\n' + json.dumps(sorted(loaded)))"
    )
    return set(json.loads(printed_by(code + report)[-1]))


def run_by(words: list[str]) -> str:
    """Code that runs a command line."""
    return f"""
import sys
from cmbot.cli import main
sys.argv = ["cmbot", *{words!r}]
try:
    main()
except SystemExit as ended:
    assert ended.code in (None, 0, 2)
"""


def test_importing_cmbot_loads_nothing_heavy_and_a_name_what_it_needs() -> None:
    assert not loaded_by("import cmbot\ncmbot.__version__, cmbot.SceneError, dir(cmbot)") & HEAVY
    # The same look finds the heavy ones when they are there.
    assert loaded_by("import cmbot\ncmbot.load_scene") >= {"numpy", "pydantic"}
    assert "matplotlib" not in loaded_by("import cmbot\ncmbot.plot, cmbot.replay")


def documented_names() -> list[str]:
    """What docs/api.md names: in its tables, with what it is for example, and by its headings."""
    lines = (ROOT / "docs" / "api.md").read_text(encoding="utf-8").splitlines()
    names = [
        name for line in lines if line.startswith("|") for name in re.findall(r"\bcmbot(?:\.\w+)+", line)
    ]
    for line, options in pairwise([*lines, ""]):
        if line.startswith("::: "):
            heading = re.search(r"heading: ([\w.]+)", options)
            names.append(heading[1] if heading else line.removeprefix("::: "))
    return sorted(set(names))


@pytest.mark.parametrize("backwards", [False, True])
def test_every_documented_name_is_there_after_importing_cmbot_alone(backwards: bool) -> None:
    names = sorted(documented_names(), reverse=backwards)
    assert len(names) > 50
    assert {"cmbot.planning.verdict", "cmbot.identification.propose"} <= set(names)
    look = f"""
import sys
import cmbot
assert not [name for name in sys.modules if name.startswith(("cmbot.planning", "cmbot.identification"))]
missing = []
for name in {names!r}:
    found = cmbot
    for part in name.split(".")[1:]:
        found = getattr(found, part, missing)
    if found is missing:
        missing.append(name)
print(missing)
"""
    assert printed_by(look)[-1] == "[]"


@pytest.mark.parametrize(
    "words", [["--help"], ["plan", "--help"], ["--version"], ["scenes"], ["doctor"], ["plan", "nosuch"]]
)
def test_the_command_line_loads_the_robot_only_when_it_is_needed(words: list[str]) -> None:
    loaded = loaded_by(run_by(words))
    assert not loaded & {"pinocchio", "coal", "meshcat", "trimesh"}
    assert not loaded & {"numpy", "scipy"} or "nosuch" in words  # a scene's poses are made with them


def test_planning_loads_nothing_that_it_does_not_use(tmp_path: Path) -> None:
    scene, planner = tmp_path / "short.json", {"knots": "sliding", "path_step_s": 0.02}
    scene.write_text(json.dumps(SHORT | {"planner": planner}), encoding="utf-8")
    loaded = loaded_by(run_by(["plan", str(scene), "-o", str(tmp_path / "plan")]), depth=2)
    assert (tmp_path / "plan" / "report.html").exists()
    # Vibration is suppressed with least distances, which `scipy.optimize` finds.
    assert loaded >= {"cmbot.views", "pinocchio", "scipy.linalg", "scipy.optimize"}
    assert not loaded & NOT_TO_PLAN


def test_a_command_searches_rarely_for_cycles_and_has_one_thread_of_blas() -> None:
    look = """
import gc, sys
from cmbot.__main__ import main
sys.argv = ["cmbot", "--version"]
try:
    main()
finally:
    import numpy, threadpoolctl
    print(gc.get_threshold()[0] >= 10_000, {each["num_threads"] for each in threadpoolctl.threadpool_info()})
"""
    assert printed_by(look)[-1] == "True {1}"


def test_what_scipy_imports_of_numpy_is_loaded_when_it_is_used() -> None:
    look = """
import sys
from cmbot.__main__ import main
sys.argv = ["cmbot", "--version"]
try:
    main()
finally:
    import numpy, scipy.linalg
    print("unittest" in sys.modules, numpy.testing.assert_allclose.__name__, "unittest" in sys.modules)
"""
    assert printed_by(look)[-1] == "False assert_allclose True"


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's allocator is set up")
def test_memory_of_blocks_that_come_and_go_stays() -> None:
    look = """
import resource, sys
from cmbot.__main__ import main
sys.argv = ["cmbot", "--version"]
try:
    main()
finally:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for megabytes in range(1, 24):
        b"-" * (megabytes << 20)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
    # The largest one's pages, and not those of all.
    assert int(printed_by(look)[-1]) < 2 * 23 * 2**20 / resource.getpagesize()


def test_nothing_is_looked_through_at_the_end() -> None:
    look = "import atexit, gc\natexit.register(lambda: print(gc.get_freeze_count() > 1000))\n"
    assert printed_by(look + run_by(["--version"]))[-1] == "True"


def test_dir_and_all_are_complete() -> None:
    assert set(cmbot.__all__) <= set(dir(cmbot))
    assert len(cmbot.__dir__()) == len(set(cmbot.__dir__()))
    assert len(cmbot.__all__) == len(set(cmbot.__all__))
    public = {name for name in dir(cmbot) if not name.startswith("_")}
    helpers = {"annotations", "exported", "on_first_use", "TYPE_CHECKING"}
    modules = {name for name in public if inspect.ismodule(getattr(cmbot, name))}
    assert public - modules - helpers == set(cmbot.__all__) - {"__version__"}


@pytest.mark.parametrize("package", [cmbot, archive, campaigns, collision, views])
def test_the_names_that_type_checkers_see_are_imported_when_first_used(package: ModuleType) -> None:
    assert package.__file__ is not None
    tree = ast.parse(Path(package.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    assert len(imports) == len(block.body) > 0
    # A module of that name would hide it.
    modules = {path.stem for path in Path(package.__file__).parent.iterdir()}
    for node in imports:
        for name in node.names:
            assert getattr(package, name.name) is getattr(import_module(str(node.module)), name.name)
            assert name.name not in modules or str(node.module).rpartition(".")[0] != package.__name__


def test_every_public_name_is_there_and_documented_and_an_unknown_one_an_error() -> None:
    assert isinstance(cmbot.__version__, str)
    for name in set(cmbot.__all__) - {"__version__"}:
        value = getattr(cmbot, name)
        assert value.__name__ == name
        assert inspect.getdoc(value), name
    with pytest.raises(AttributeError, match="module 'cmbot' has no attribute 'simulate_everything'"):
        cmbot.simulate_everything  # noqa: B018
    with pytest.raises(ImportError, match="nothing_of_ours"):
        exec("from cmbot import nothing_of_ours")
