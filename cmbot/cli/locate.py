"""The command that finds a workpiece from touched points: `cmbot locate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cmbot
from cmbot.cli.command import Writing, argument, option
from cmbot.cli.completion import complete_scene
from cmbot.cli.console import out
from cmbot.cli.views import require_new
from cmbot.common.errors import InputError, one_line

if TYPE_CHECKING:
    from cmbot.identification import Location


@dataclass(frozen=True, kw_only=True)
class LocateCommand(Writing):
    """Find out where a workpiece is, from places that the tool touched on it.

    With --propose the corners to touch, as a sheet to fill in, and how exact the place will be. Without it
    the frame's pose and how exactly it is known, as blocks that go into the scene: frames, uncertainty.

    Example: cmbot locate triangle --propose 4, then cmbot locate triangle.touches.yaml
    """

    source: str = argument(
        "A file of touches, YAML or CSV; with --propose a scene.", "FILE", complete=complete_scene
    )
    output: Path | None = option(None, "File to write; named by FILE if left out.", "--output", "-o")
    scene: str | None = option(None, "Scene in place of the file's; a CSV file needs one.", metavar="SCENE")
    propose: int | None = option(None, "Propose so many corners to touch.", least=1, most=100)

    def __call__(self) -> None:
        from cmbot.archive import write_file

        if self.propose is not None:
            self._propose(self.propose)
            return
        from cmbot.identification import located, location_remarks, read_touches

        touches = read_touches(self.source, self.scene)
        found = located(touches)
        remarks = list(location_remarks(found, touches))
        target = self.output or Path(f"{Path(self.source).with_suffix('')}.location.yaml")
        require_new(target, self.force)
        write_file(target, _blocks(found, remarks).encode())

        def say() -> None:
            for line in remarks:
                out.print(one_line(line))
            out.print(f"Written to {one_line(str(target))}: {_use(found)}.")

        self.answer(lambda: {"file": str(target), **_summary(found), "remarks": remarks}, say)

    def _propose(self, number: int) -> None:
        """Propose corners, and write the sheet."""
        from cmbot.archive import write_file
        from cmbot.common.validation import counted
        from cmbot.common.yaml_reader import yaml_text
        from cmbot.identification import TouchSetup, features_to_touch, frame_of, placement_of

        if Path(self.source).suffix.lower() == ".csv":
            raise InputError(self.source, "--propose", "a CSV file", "a scene, whose corners can be touched")
        scene = cmbot.load_scene(self.source)
        features, covariance = features_to_touch(scene, number)
        target = self.output or Path(f"{scene.name}.touches.yaml")
        require_new(target, self.force)
        joints = len(scene.posture)
        frame, X_WF = frame_of(scene)
        in_frame = [X_WF[:3, :3].T @ (feature.point - X_WF[:3, 3]) for feature in features]
        points = [[round(float(x), 6) for x in point] for point in in_frame]
        setup = TouchSetup()
        sheet = {
            "format": "cmbot-touches/1",
            "scene": self.source,
            "locates": frame,
            "touch_sd_mm": setup.touch_sd_mm,
            "touches": [{"posture_deg": None, "point": point} for point in points],
        }
        text = (
            f"# Touch each corner with the tool point, and write down the {joints} angles of the joints.\n"
            f"# The points are in {'W' if frame == 'world' else f'the frame {frame} of the scene'}.\n"
        )
        write_file(target, (text + yaml_text(sheet)).encode())
        known = placement_of(covariance)
        words = (
            f"After {counted(len(points), 'touch', 'touches')} its place will be known within {known.mm:.2f} "
            f"mm and {known.deg:.3f} deg, one standard deviation in the worst direction."
        )

        def say() -> None:
            out.print(words)
            sheet = one_line(str(target))
            out.print(f"Sheet to fill in: {sheet}; then: cmbot locate {sheet}")

        self.answer(
            lambda: {"file": str(target), "touches": points, "shift_mm": known.mm, "turn_deg": known.deg}, say
        )


def _summary(found: Location) -> dict[str, Any]:
    """What was found, as JSON has it."""
    import numpy as np

    known = found.placement
    return {
        "frame": found.frame,
        "xyz": found.X_WF[:3, 3].tolist(),
        "rpy_deg": np.degrees(found.rpy).tolist(),
        "mm": known.mm,
        "deg": known.deg,
        "covariance": found.covariance.tolist(),
        "left_out": list(found.left_out),
        "not_fixed": list(found.not_fixed),
    }


def _use(found: Location) -> str:
    """What to do with the blocks."""
    if found.frame == "world":
        return (
            "with from: {frame: workpiece, ...} in the scene's strokes and frame: workpiece in its obstacles"
            " these follow it"
        )
    return "its blocks go into the scene"


def _blocks(found: Location, remarks: list[str]) -> str:
    """The blocks of a scene that say where the workpiece is, below what was found in words."""
    told, known = _summary(found), found.placement
    name = "workpiece" if found.frame == "world" else found.frame
    xyz, rpy = ([round(x, 7) for x in told[key]] for key in ("xyz", "rpy_deg"))
    lines = [f"# {one_line(line)}" for line in remarks]
    lines.append(f"frames: {{{name}: {{xyz: {xyz}, rpy_deg: {rpy}}}}}")
    # Nothing in the scene follows a frame that it did not have, so its path is known no better.
    if found.frame != "world":
        lines += [
            "uncertainty:",
            f"  workpiece: {{mm: {known.mm:.4g}, deg: {known.deg:.4g}}}",
            "  foot: {mm: 0, deg: 0}  # the place is that of the workpiece relative to the foot",
        ]
    return "\n".join([*lines, ""])
