"""Where the robot works: the scene file, the tool path, obstacles, the guardrail, the planner's options."""

from cmbot.common.installation import shipped_scenes as shipped_scenes
from cmbot.common.reading.fields import FOLDER as FOLDER
from cmbot.scene.base.guardrail import (
    GuardrailFile as GuardrailFile,
    elastic_guardrail as elastic_guardrail,
    feet_at as feet_at,
    guardrail_obstacles as guardrail_obstacles,
)
from cmbot.scene.base.hold import Face as Face, held_member as held_member
from cmbot.scene.base.identified import IdentifiedStiffness as IdentifiedStiffness
from cmbot.scene.base.stance import (
    LIFT_M as LIFT_M,
    PLATE_OFFSET_M as PLATE_OFFSET_M,
    FootholdFile as FootholdFile,
    Stance as Stance,
    StanceFile as StanceFile,
    axis_point as axis_point,
    foothold_face as foothold_face,
    foothold_pose as foothold_pose,
)
from cmbot.scene.changes import (
    changed_content as changed_content,
    is_within as is_within,
    whole_key as whole_key,
)
from cmbot.scene.excitation import (
    DamperFile as DamperFile,
    ExcitationFile as ExcitationFile,
    TrainsFile as TrainsFile,
)
from cmbot.scene.files import TRAINS as TRAINS
from cmbot.scene.obstacles import ObstacleFile as ObstacleFile
from cmbot.scene.options import MOST_SAMPLES as MOST_SAMPLES, PlannerOptions as PlannerOptions
from cmbot.scene.path.path_file import (
    WORK as WORK,
    AxisCone as AxisCone,
    JobStrokes as JobStrokes,
    Keep as Keep,
    StrokeFile as StrokeFile,
)
from cmbot.scene.path.stroke import (
    Stroke as Stroke,
    coverage_of as coverage_of,
    pieces_left_out as pieces_left_out,
)
from cmbot.scene.path.stroke_parts import (
    allowed_cuts as allowed_cuts,
    rows_alone as rows_alone,
    waypoint_shares as waypoint_shares,
)
from cmbot.scene.robot_entry import (
    STOW as STOW,
    AttachedToolFile as AttachedToolFile,
    MountFile as MountFile,
    NamedState as NamedState,
    PostureFile as PostureFile,
    RobotFile as RobotFile,
)
from cmbot.scene.scene import Scene as Scene
from cmbot.scene.scene_file import (
    load_scene as load_scene,
    scene_from_data as scene_from_data,
    scene_path as scene_path,
)
from cmbot.scene.template import (
    NewRobot as NewRobot,
    limits_text as limits_text,
    mount_entry as mount_entry,
    scene_text as scene_text,
    start_entry as start_entry,
)
from cmbot.scene.tool import SPEED_TOLERANCE as SPEED_TOLERANCE, Tool as Tool
from cmbot.scene.uncertainty import (
    Placement as Placement,
    Tolerance as Tolerance,
    Uncertainty as Uncertainty,
)
