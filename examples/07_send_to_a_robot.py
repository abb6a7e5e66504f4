"""Send a planned job to a robot that runs ROS 2.

``cmbot export DIR --ros FILE`` writes the whole job as a ROS ``trajectory_msgs/JointTrajectory``. This makes
the goal of a ``control_msgs/FollowJointTrajectory`` action of it, and sends it where ROS is installed:
``python 07_send_to_a_robot.py out/triangle triangle /arm_controller``. The plan is verified before: it has to
keep what the scene asks. Without ROS, or without a controller, it shows the goal. The arm has to stand in the
posture that it prints first.
"""

import json
import sys
import tempfile
from pathlib import Path

import cmbot
from cmbot.archive import export_ros

# The fields of control_msgs/action/FollowJointTrajectory, its goal.
GOAL = """trajectory_msgs/JointTrajectory trajectory
JointTolerance[] path_tolerance
JointTolerance[] goal_tolerance
builtin_interfaces/Duration goal_time_tolerance"""


def goal_of(folder: Path, scene: cmbot.Scene, *, tolerance: float = 0.01) -> dict:
    """The goal of the whole job of a scene; at its end every joint may be off by `tolerance`, rad."""
    plan = cmbot.load_plan(folder, verify=True, scene=scene)
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "job.ros.json"
        export_ros(plan, file)
        trajectory = json.loads(file.read_text(encoding="utf-8"))
    bounds = [{"name": joint, "position": tolerance} for joint in trajectory["joint_names"]]
    goal = {
        "trajectory": trajectory,
        "path_tolerance": [],
        "goal_tolerance": bounds,
        "goal_time_tolerance": {"sec": 1, "nanosec": 0},
    }
    if list(goal) != [line.split()[1] for line in GOAL.splitlines()]:
        raise ValueError("the goal has other fields than the action's definition")
    return goal


def send(goal: dict, controller: str) -> None:
    """Send a goal to a controller of ros2_control, and wait for its end; without ROS nothing is sent."""
    try:
        import rclpy
    except ModuleNotFoundError:
        print("ROS 2 is not installed here: nothing is sent")
        return
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient
    from rosidl_runtime_py import set_message_fields

    rclpy.init()
    node = rclpy.create_node("cmbot_job")
    client = ActionClient(node, FollowJointTrajectory, f"{controller}/follow_joint_trajectory")
    client.wait_for_server()
    message = FollowJointTrajectory.Goal()
    set_message_fields(message, goal)
    sent = client.send_goal_async(message)
    rclpy.spin_until_future_complete(node, sent)
    handle = sent.result()
    if not handle.accepted:
        rclpy.shutdown()
        raise SystemExit(f"{controller} did not accept the goal: its log says why")
    done = handle.get_result_async()
    rclpy.spin_until_future_complete(node, done)
    result = done.result().result
    rclpy.shutdown()
    if result.error_code != FollowJointTrajectory.Result.SUCCESSFUL:
        raise SystemExit(f"the arm did not finish: error {result.error_code}, {result.error_string}")
    print("done")


def short_scene() -> cmbot.Scene:
    """A small job, for this example to have one."""
    scene = {
        "format": "cmbot-scene/2",
        "name": "short",
        "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
        "tool_path": {"legs": [{"by": [0, -0.3, 0], "seconds": 4}], "via_points": 8},
        "planner": {"knots": "fixed", "path_step_s": 0.02},
    }
    return cmbot.load_scene(scene)


def main(folder: Path, scene: cmbot.Scene, controller: str = "") -> None:
    """Show the goal of a plan of a scene, and send it where a controller is named."""
    goal = goal_of(folder, scene)
    points = goal["trajectory"]["points"]
    print("joints:", ", ".join(goal["trajectory"]["joint_names"]))
    print("starts in:", ", ".join(f"{angle:.4f}" for angle in points[0]["positions"]), "rad, m")
    last = points[-1]["time_from_start"]
    print(f"{len(points)} points in {last['sec'] + 1e-9 * last['nanosec']:.2f} s")
    if controller:
        send(goal, controller)
    else:
        print("no controller named: nothing is sent")


if __name__ == "__main__":
    if len(sys.argv) > 2:
        main(Path(sys.argv[1]), cmbot.load_scene(sys.argv[2]), *sys.argv[3:4])
    else:
        with tempfile.TemporaryDirectory() as temporary:
            short = short_scene()
            main(cmbot.save(cmbot.plan(short), Path(temporary) / "short"), short)
