"""The permissions of the nodes in a secured ROS domain."""
