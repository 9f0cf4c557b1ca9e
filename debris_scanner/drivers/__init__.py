"""Depth cameras through OpenNI2 and libfreenect, without ROS: each device in a process of its own."""
