"""The robot: its model from a URDF, its kinematics and its dynamics."""

from cmbot.robot.climber import (
    CLIMBING_JOINTS as CLIMBING_JOINTS,
    Climber as Climber,
    ClimberBodies as ClimberBodies,
)
from cmbot.robot.description.completion import AttachedTool as AttachedTool, ToolShape as ToolShape
from cmbot.robot.description.files import RobotFiles as RobotFiles, robot_files as robot_files
from cmbot.robot.description.limits_file import RATE_KEYS as RATE_KEYS
from cmbot.robot.description.mesh_file import (
    box_about as box_about,
    convex_hull as convex_hull,
    encloses_volume as encloses_volume,
    faces_of as faces_of,
    is_mesh as is_mesh,
    locate_meshes as locate_meshes,
    solid_points as solid_points,
    vertices_of as vertices_of,
)
from cmbot.robot.description.self_collision import (
    MOST_FAR as MOST_FAR,
    NEAR as NEAR,
    sampled_postures as sampled_postures,
)
from cmbot.robot.description.xml_file import parse_urdf as parse_urdf
from cmbot.robot.dynamics import Dynamics as Dynamics, Efforts as Efforts, external_forces as external_forces
from cmbot.robot.elasticity import JointElasticity as JointElasticity, LinkTube as LinkTube
from cmbot.robot.holding_joints import (
    HoldingJoint as HoldingJoint,
    holding_rows as holding_rows,
    leg_compliance as leg_compliance,
)
from cmbot.robot.inspection import (
    Finding as Finding,
    inspect_robot as inspect_robot,
    inspect_urdf as inspect_urdf,
    overview as overview,
)
from cmbot.robot.joint_kinds import (
    Coupling as Coupling,
    PostureMetric as PostureMetric,
    joint_units as joint_units,
    postures_in_words as postures_in_words,
    prismatic_joints as prismatic_joints,
    slide_axes as slide_axes,
    turn_axis as turn_axis,
)
from cmbot.robot.kinematics import (
    Chain as Chain,
    Kinematics as Kinematics,
    PostureBatch as PostureBatch,
    Postures as Postures,
    ToolBatch as ToolBatch,
    frame_about as frame_about,
    link_poses as link_poses,
)
from cmbot.robot.limits import ASSUMPTIONS as ASSUMPTIONS, JointLimits as JointLimits
from cmbot.robot.loading import (
    ARM_JOINTS as ARM_JOINTS,
    Side as Side,
    inspect_loaded as inspect_loaded,
    load_climbing_robot as load_climbing_robot,
    load_robot as load_robot,
    other_foot as other_foot,
    srdf_text as srdf_text,
)
from cmbot.robot.robot import Robot as Robot
