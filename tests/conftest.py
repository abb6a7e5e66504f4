"""What all tests share: the shipped robot, repeatable random numbers, Hypothesis settings."""

import gc
import math
import os
import re
import signal
from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path

# As many workers as cores, and matrices are small: before numpy is there, and for the processes tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Workers and the processes that tests start compile the package once, as a user's do, whatever the
# environment says. What is installed is compiled already, beside its sources.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers
from rail_arms import rail_scene
from shared_plans import planned
from shared_robots import loaded
from small_scenes import short_scene, strokes_scene
from state_samples import FloatArray, StateSamples
from urdf_arms import arm_scene, endless_scene

from cmbot.common.installation import model_folder
from cmbot.planning import Deadline, Plan, planner, robot_of
from cmbot.planning.selfmotion import sampler
from cmbot.robot import Dynamics, Kinematics, Robot, load_robot
from cmbot.scene import PlannerOptions, load_scene
from cmbot.simulation import SimulationOptions, Tracking, simulate
from cmbot.stances import charting

pytest_plugins = ["plan_folders"]

# A shell starts jobs in the background without SIGINT, and children inherit that; some tests send it to them.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# No test may depend on speed, nor on chance: what fails once fails again. New examples, which may find what
# the fixed ones do not: `pytest -m hypothesis --hypothesis-profile random`.
_ANY_SPEED = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("fixed", **_ANY_SPEED, derandomize=True)
settings.register_profile("random", **_ANY_SPEED)
settings.load_profile("fixed")
# It also takes numbers from the modules that are loaded, which the tests before decide.
providers.is_local_module_file = lambda path: False  # type: ignore[attr-defined]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What tests load stays to the end: the collector of garbage looks at it neither now nor later."""
    gc.disable()
    loaded = yield
    gc.freeze()
    gc.enable()
    return loaded


@pytest.fixture(scope="session", autouse=True)
def _without_the_default_time_limit() -> Iterator[None]:
    """On a slow machine too, plans are what they are: only limits that a test gives count."""

    def deadline(limit: float) -> Deadline:
        return Deadline(math.inf if limit == PlannerOptions.time_limit_s else limit)

    with pytest.MonkeyPatch.context() as patch:
        for module in (planner, charting):
            patch.setattr(module, "Deadline", deadline)
        yield


@pytest.fixture(scope="session", autouse=True)
def _robots_once() -> Iterator[None]:
    """Where planning loads that of a scene."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cmbot.planning.workcell.workcell.load_robot", loaded)
        yield


@pytest.fixture(autouse=True)
def _without_charts_of_other_tests() -> None:
    """What a test finds does not depend on those before it."""
    sampler._SAMPLER_CACHE.clear()


@pytest.fixture(scope="session")
def cmbot_robot() -> Robot:
    return load_robot("cmbot")


@pytest.fixture(scope="session")
def cmbot_dynamics(cmbot_robot: Robot) -> Dynamics:
    return Dynamics(cmbot_robot)


@pytest.fixture(scope="session")
def cmbot_kinematics(cmbot_robot: Robot) -> Kinematics:
    return Kinematics(cmbot_robot)


@pytest.fixture(scope="session")
def triangle_plan() -> Plan:
    return planned(load_scene("triangle"))


@pytest.fixture(scope="session")
def line_plan() -> Plan:
    return planned(load_scene("line"))


@pytest.fixture(scope="session")
def triangle_tracking(triangle_plan: Plan) -> Tracking:
    return simulate(triangle_plan)


@pytest.fixture(scope="session")
def compensated_short() -> tuple[Plan, Tracking]:
    made = planned(short_scene(planner={"compensate": True}))
    return made, simulate(made, SimulationOptions(settle_s=0.5))


@pytest.fixture(scope="session")
def returning_plan() -> Plan:
    """From the short scene's posture to work, with an approach, and to the stow posture."""
    planner = {"knots": "sliding"}
    return planned(short_scene(planner=planner, **{"return": "stow"}))


@pytest.fixture(scope="session")
def strokes_plan() -> Plan:
    """Of two strokes, `there` and `back`, with an approach, a free move between them and a return."""
    return planned(strokes_scene())


@pytest.fixture(scope="session")
def strokes_tracking(strokes_plan: Plan) -> Tracking:
    return simulate(strokes_plan, SimulationOptions(settle_s=0.5))


def _with_fixed_knots(name: str) -> Plan:
    scene = load_scene(name)
    return planned(scene, options=replace(scene.planner, knots="fixed", compensate=False))


@pytest.fixture(scope="session")
def fixed_triangle_plan() -> Plan:
    """The paper's own problem: via-points stay on the gradient-projection path."""
    return _with_fixed_knots("triangle")


@pytest.fixture(scope="session")
def rail_plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """Of an arm of seven joints, two of which slide."""
    return planned(rail_scene(tmp_path_factory.mktemp("rail"), start="pinned"))


@pytest.fixture(scope="session")
def fixed_line_plan() -> Plan:
    return _with_fixed_knots("line")


@pytest.fixture(scope="session", params=["cmbot", "panda", "kinova", "endless", "rail"])
def any_arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """The shipped arm with a load; on a mount a Panda, a Kinova, arms with endless joints and on a rail."""
    folder = tmp_path_factory.mktemp(request.param)
    match request.param:
        case "cmbot":
            return load_robot(payload=3.0)
        case "endless":
            return robot_of(endless_scene(folder))
        case "rail":
            return robot_of(rail_scene(folder))
        case name:
            return robot_of(arm_scene(folder, name))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(2793)


@pytest.fixture
def random_states(rng: np.random.Generator) -> StateSamples:
    """Function of a robot and a number N: q within the ranges, v to 3 times the limits, a to 20 rad/s2."""

    def states(robot: Robot, number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        lower, upper = np.clip(robot.limits.lower, -np.pi, None), np.clip(robot.limits.upper, None, np.pi)
        q = rng.uniform(lower, upper, (number, robot.dof))
        v = rng.uniform(-3, 3, q.shape) * robot.limits.velocity
        return q, v, rng.uniform(-20, 20, q.shape)

    return states


@pytest.fixture(scope="session")
def bare_urdf() -> str:
    """Text of the shipped URDF without its visual meshes: it loads from anywhere, and faster."""
    text = (model_folder() / "urdf" / "cmbot.urdf").read_text(encoding="utf-8")
    return re.sub(r"<visual.*?</visual>", "", text, flags=re.DOTALL)


@pytest.fixture
def urdf_folder(tmp_path: Path, bare_urdf: str) -> Path:
    """Folder with a copy of the shipped robot's three files, to be changed by a test."""
    (tmp_path / "cmbot.urdf").write_text(bare_urdf, encoding="utf-8")
    for name in ("cmbot.srdf", "joint_limits.yaml"):
        (tmp_path / name).write_bytes((model_folder() / "urdf" / name).read_bytes())
    return tmp_path
