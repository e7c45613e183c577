"""Extensions of the commands of ROS 2."""
