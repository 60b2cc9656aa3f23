"""ROS messages of hands and cells: types, conversion, bag topics. Nothing here communicates."""
