"""The ROS layer: the reports of a running system, what operators ask for, and the command."""
