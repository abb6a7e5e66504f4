"""Plans that several tests need, made once in a run of all workers."""

import atexit
import fcntl
import os
import pickle
import shutil
from functools import cache
from hashlib import sha256
from json import dumps
from pathlib import Path
from tempfile import mkdtemp

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
        if not file.exists():
            file.write_bytes(pickle.dumps(plan(scene, options=options, progress=False)))
    return _read(file)


@cache
def _read(file: Path) -> Plan:
    """All have a copy, he who made it, too: what tests find does not depend on who that was."""
    made: Plan = pickle.loads(file.read_bytes())
    return made
