"""Running streams: operators over samples, without ROS."""
