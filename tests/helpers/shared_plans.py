"""Plans that several tests need, made once in a run of all workers."""

import atexit
import fcntl
import io
import os
import pickle
import shutil
from hashlib import sha256
from json import dumps
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import cloudpickle

from cmbot.planning import Plan, WrenchFunction, plan
from cmbot.scene import PlannerOptions, Scene

_NAMED_BY, _OWN = "CMBOT_TESTS_PLANS", os.getpid()


def _removed(folder: str) -> None:
    if os.getpid() == _OWN:  # and not a child of it
        shutil.rmtree(folder, ignore_errors=True)


# The process that starts workers makes the folder, they inherit its name.
if _NAMED_BY not in os.environ:
    os.environ[_NAMED_BY] = mkdtemp(prefix="cmbot_plans_")
    atexit.register(_removed, os.environ[_NAMED_BY])


class _Pickler(cloudpickle.Pickler):
    """Also of errors, whose fields are named: Python would make them of their message alone."""

    def reducer_override(self, made: Any) -> Any:
        if isinstance(made, Exception):
            return type(made).__new__, (type(made), *made.args), vars(made)
        return super().reducer_override(made)


def planned(
    scene: Scene,
    *,
    options: PlannerOptions | None = None,
    objective: WrenchFunction | None = None,
    progress: object = None,
) -> Plan:
    """What `plan` makes of a scene, in its place; no test may change it.

    Who asks first makes it. It is only for what planning gives, not for how it goes about it.
    """
    del progress
    if objective is not None:  # a function has no name that is its own
        return plan(scene, options=options, objective=objective, progress=False)
    asked = dumps([scene.content_hash, scene.as_data(), repr(options)])
    file = Path(os.environ[_NAMED_BY]) / sha256(asked.encode()).hexdigest()
    with file.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if file not in _KNOWN:
            _KNOWN[file] = _read(file) if file.exists() else _written(file, plan(scene, options=options))
    return _KNOWN[file]


_KNOWN = dict[Path, Plan]()


def _read(file: Path) -> Plan:
    made: Plan = pickle.loads(file.read_bytes())
    return made


def _written(file: Path, made: Plan) -> Plan:
    """Write a plan, and return it as others read it: what tests find does not depend on who made it."""
    text = io.BytesIO()
    try:
        _Pickler(text).dump(made)
    except RuntimeError:  # convex meshes of coal are not written: each worker has its own plan
        return made
    file.write_bytes(text.getvalue())
    return _read(file)
