"""ROS 1, ROS 2 and MCAP recordings to captures."""
