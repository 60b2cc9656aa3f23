"""From one table of facts to the MJCF, the URDF and the meshes of both hands."""
