"""Writing and replaying rosbag2 recordings without ROS."""
