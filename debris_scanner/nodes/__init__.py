"""ROS 2 nodes: thin shells that declare, convert, call and publish."""
