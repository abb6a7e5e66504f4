"""Which robot descriptions, as they lie on disk, get to a certified plan by `new` and `plan` alone.

    python benchmarks/robots.py                    # installs three packages into a temporary folder
    python benchmarks/robots.py --packages FOLDER  # as they are there, from `pip install --target FOLDER`
    python benchmarks/robots.py --only foreign     # the small ones of tests/robot/foreign alone

None of them is in example-robot-data. Those of the packages rtb-data, robosuite and pybullet are as
published; those of tests/robot/foreign were written after what publishers do: no masses, no effort, macros,
arguments, the folders of MoveIt, paths of another machine, stickers. Masses are those of data sheets, or
about that. A tool point in the robot's reach is given with each, as who knows the robot would give it.

The second table has descriptions that say something wrong: they have to be refused, with what to do.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parent.parent
FOREIGN = ROOT / "tests" / "robot" / "foreign"
PACKAGES = ("rtb-data==2.0.0", "robosuite==1.5.2", "pybullet==3.2.7")
GOAL = 0.95
_SECONDS = 300.0
_RTB, _SUITE = "rtbdata/xacro", "robosuite/models/assets/bullet_data"
_KUKA, _TROSSEN = f"{_RTB}/kuka_description", f"{_RTB}/trossen_descriptions/urdf"


@dataclass(frozen=True, kw_only=True)
class Case:
    """A description: its file, where its tool is to be, and options of `new`."""

    file: str
    at: tuple[float, float, float] = (0.5, 0.0, 0.6)
    options: tuple[str, ...] = ()


def _case(file: str, *at: float, mass: float | None = None, options: Sequence[str] = ()) -> Case:
    x, y, z = at or (0.5, 0.0, 0.6)
    weighed = () if mass is None else ("--total-mass", str(mass))
    return Case(file=file, at=(x, y, z), options=(*weighed, *options))


PUBLISHED = (
    _case(f"{_RTB}/abb_irb140_description/urdf/irb140.xacro", 0.5, 0, 0.6, mass=98),
    _case(f"{_RTB}/abb_irb140_description/urdf/irb140.urdf", 1.2, 1.4, 1.6, mass=98),
    _case(f"{_RTB}/abb_irb140_description/urdf/irb140QT.urdf", 1.2, 1.4, 1.6, mass=98),
    _case(f"{_KUKA}/kuka_kr3/urdf/kr3r540.xacro", 0.3, 0, 0.4, mass=26),
    _case(f"{_KUKA}/kuka_kr5/urdf/kr5_arc.xacro", 0.8, 0, 0.6),
    _case(f"{_KUKA}/kuka_kr6/urdf/kr6r700sixx.xacro", 0.4, 0, 0.5, mass=50),
    _case(f"{_KUKA}/kuka_kr6/urdf/kr6r900sixx.xacro", 0.5, 0, 0.5, mass=52),
    _case(f"{_KUKA}/kuka_kr10/urdf/kr10r1100sixx.xacro", 0.6, 0, 0.6, mass=54),
    _case(f"{_KUKA}/kuka_kr16/urdf/kr16_2.urdf", 0.9, 0, 0.9),
    _case(f"{_KUKA}/kuka_kr16/urdf/kr16_2.xacro", 0.9, 0, 0.9),
    _case(f"{_KUKA}/kuka_kr120/urdf/kr120r2500pro.urdf", 1.5, 0, 1.3),
    _case(f"{_KUKA}/kuka_kr120/urdf/kr120r2500pro.xacro", 1.5, 0, 1.3),
    _case(f"{_KUKA}/kuka_kr150/urdf/kr150_2.xacro", 1.5, 0, 1.3, mass=1245),
    _case(f"{_KUKA}/kuka_kr210/urdf/kr210l150.xacro", 1.7, 0, 1.3),
    _case(f"{_KUKA}/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.xacro", 0.5, 0, 0.5, mass=30),
    _case(f"{_RTB}/lynxmotion_al5d_description/urdf/al5d_robot.urdf", 0.2, 0, 0.15),
    _case(f"{_RTB}/unimation_puma560_description/urdf/puma560_robot.urdf.xacro", 0.1, 0.45, 1.17, mass=54),
    _case(f"{_TROSSEN}/px100.urdf.xacro", 0.15, 0, 0.15),
    _case(f"{_TROSSEN}/rx150.urdf.xacro", 0.25, 0.1, 0.25),
    _case(f"{_TROSSEN}/vx300s.urdf.xacro", 0.35, 0, 0.3),
    _case(f"{_TROSSEN}/wx200.urdf.xacro", 0.3, 0, 0.25),
    _case(f"{_TROSSEN}/wx250s.urdf.xacro", 0.3, 0, 0.3),
    _case("rtbdata/armer_xarm/data/xacro/robots/xarm6/xarm6.xacro", 0.3, 0, 0.3),
    _case(f"{_RTB}/qut_frankie_description/robots/panda_arm_hand.urdf.xacro", 0.4, 0, 0.5, mass=18),
    _case(
        f"{_RTB}/qut_frankie_description/robots/frankie_arm_hand.urdf.xacro",
        *(0.5, 0, 0.8),
        mass=120,
        options=("--base", "panda_link0"),
    ),
    _case("pybullet_data/xarm/xarm6_robot.urdf", 0.3, 0, 0.3),
    _case("pybullet_data/xarm/xarm6_robot_white.urdf", 0.3, 0, 0.3),
    _case("pybullet_data/xarm/xarm6_with_gripper.urdf", 0.3, 0, 0.3),
    _case("pybullet_data/franka_panda/panda.urdf", 0.4, 0, 0.5),
    _case("pybullet_data/kuka_iiwa/model.urdf", 0.4, 0, 0.5),
    _case("pybullet_data/kuka_iiwa/model_vr_limits.urdf", 0.4, 0, 0.5),
    _case(
        f"{_SUITE}/baxter_description/urdf/baxter_arm.urdf",
        *(0.6, -0.3, 0.3),
        options=("--tool", "right_gripper"),
    ),
    _case(f"{_SUITE}/panda_description/urdf/panda_arm.urdf", 0.4, 0, 0.5),
    _case(f"{_SUITE}/panda_description/urdf/panda_arm_hand.urdf", 0.4, 0, 0.5),
    _case(f"{_SUITE}/panda_description/urdf/panda_arm_hand.urdf.xacro", 0.4, 0, 0.5),
    _case(f"{_SUITE}/sawyer_description/urdf/sawyer_arm.urdf", 0.5, 0.1, 0.4),
)
TORCH = "{{xyz: [0.2, 0, 0], rpy_deg: [0, 90, 0], mass_kg: 1.2, mesh: {}}}".format(
    FOREIGN / "flange/torch.obj"
)
ACME = "arguments/acme_description/urdf/acme.urdf.xacro"
WRITTEN = (
    _case("no_masses/acme_support/urdf/acme.urdf", mass=60),
    _case("zero_effort/arm.urdf"),
    _case("no_limits/arm.urdf"),
    _case("macros/acme-master/urdf/acme.xacro"),
    _case("renamed_package/robot/urdf/arm.urdf.xacro"),
    _case(ACME, options=("--xacro", "name=small")),
    _case(ACME, options=("--xacro", "name=large")),
    _case("moveit/urdf/acme.urdf"),
    _case("other_machine/checkout/urdf/arm.urdf"),
    _case("stickers/arm.urdf"),
    _case("flat_plate/arm.urdf"),
    _case("gripper/arm.urdf"),
    _case("two_ends/arm.urdf", options=("--tool", "flange")),
    _case("flange/arm.urdf", options=("--tool", TORCH)),
    _case("rail/arm.urdf", 0.5, 0.2, 0.6),
    _case("mimic_in_chain/arm.urdf", 0.8, 0, 0.5),
)
WRONG = {
    _case("no_masses/acme_support/urdf/acme.urdf"): "--total-mass",
    _case("macros/acme-master/urdf/acme_macro.xacro"): "acme.xacro",
    _case(ACME): "--xacro name=VALUE",
    _case(ACME, options=("--xacro", "nmae=small")): "given is nmae",
    _case("two_ends/arm.urdf"): "flange",
    _case("millimetres/arm.urdf"): "millimetres?",
    _case("degrees/arm.urdf"): "degrees?",
    _case("missing_mesh/arm.urdf"): "package_dirs",
}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How far a description came: `message` is the error of the command that refused it, empty for a plan."""

    case: Case
    message: str
    seconds: float


def tried(case: Case, folder: Path, work: Path) -> Outcome:
    """Make a scene for a description in `folder`, and plan it, in `work`."""
    begun, scene = time.perf_counter(), work / "scene.yaml"
    at = tuple(map(str, case.at))
    new = ("new", "--from", str(folder / case.file), "--tool-at", *at, *case.options, "-o", str(scene))
    plan = ("plan", str(scene), "-o", str(work / "plan"))
    message = _error(new) or _error(plan)
    return Outcome(case=case, message=message, seconds=time.perf_counter() - begun)


def _error(arguments: Sequence[str]) -> str:
    """The last line of a command that fails, which is its error; nothing of one that does its work."""
    command = [sys.executable, "-m", "cmbot", *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_SECONDS)
    except subprocess.TimeoutExpired:
        return f"error: not done after {_SECONDS:g} s"
    if done.returncode == 0:
        return ""
    return (done.stderr.strip().splitlines() or [f"error: status {done.returncode}"])[-1]


def outcomes(cases: Sequence[Case], folder: Path) -> Iterator[Outcome]:
    """Yield the outcome of each case, tried in a folder of its own."""
    for case in cases:
        with tempfile.TemporaryDirectory() as work:
            yield tried(case, folder, Path(work))


def install(folder: Path) -> None:
    """Install the packages with published descriptions into a folder, without what they depend on."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(folder)]
    subprocess.run([*command, *PACKAGES], check=True)


def _printed(console: Console, title: str, found: Sequence[Outcome], folder: Path) -> None:
    table = Table("description", "options", "s", "outcome", title=title)
    for each in found:
        options = " ".join(each.case.options).replace(str(FOREIGN), "…")
        message = each.message.replace(str(folder), "…") or "planned, certified"
        table.add_row(each.case.file, options, f"{each.seconds:.1f}", message)
    console.print(table)


def main() -> int:
    """Try all descriptions, print the tables, and return 0 where the goal is met."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packages", type=Path, help="where the packages are installed")
    parser.add_argument("--only", choices=("published", "foreign"))
    arguments = parser.parse_args()
    console, planned = Console(width=200), list[Outcome]()
    with tempfile.TemporaryDirectory() as temporary:
        packages = arguments.packages or Path(temporary)
        if arguments.only != "foreign":
            if arguments.packages is None:
                install(packages)
            published = list(outcomes(PUBLISHED, packages))
            _printed(console, "as published", published, packages)
            planned += published
        if arguments.only != "published":
            written = list(outcomes(WRITTEN, FOREIGN))
            _printed(console, "written", written, FOREIGN)
            planned += written
    refused = [] if arguments.only == "published" else list(outcomes(tuple(WRONG), FOREIGN))
    _printed(console, "with a mistake: refused, with what to do", refused, FOREIGN)
    good = sum(not each.message for each in planned)
    told = sum(WRONG[each.case] in each.message for each in refused)
    console.print(f"planned: {good} of {len(planned)} ({good / len(planned):.1%}); goal {GOAL:.0%}")
    console.print(f"refused with what to do: {told} of {len(refused)}")
    return 0 if good >= GOAL * len(planned) and told == len(refused) else 1


if __name__ == "__main__":
    sys.exit(main())
