"""The library: named postures, grasps and gains, stored as YAML."""
