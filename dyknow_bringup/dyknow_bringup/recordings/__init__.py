"""Reading, writing and replaying rosbag2 recordings without ROS."""
