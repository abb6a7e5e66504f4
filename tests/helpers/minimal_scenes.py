"""The shortest content of a scene file, and the robot block of another URDF."""

MINIMAL = {
    "format": "cmbot-scene/2",
    "name": "small",
    "start": {"posture_deg": [0, 90]},
    "tool_path": {"legs": [{"by": [0, 0, 1], "seconds": 2}]},
}
OTHER_ROBOT = {
    "model": "arm.urdf",
    "base_frame": "base",
    "tool_frame": "flange",
    "limits": "limits.yaml",
    "mount": {"xyz": [0, 0, 1], "rpy_deg": [180, 0, 90]},
}
