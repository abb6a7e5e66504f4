"""What is verified of folders: that they are what was asked for, and what goes to the robot."""
