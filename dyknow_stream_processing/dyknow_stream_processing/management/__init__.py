"""Registration and placement of streams on engines, without ROS."""
