"""The robot description: its files (URDF, xacro, SRDF, meshes, ROS packages) and the frames of its arm."""
