"""numpy to and from ROS messages: clouds, depth images, poses, meshes, markers and bags."""
