"""Conversion of recordings: rosbag2, MCAP, LeRobot, Minari, Parquet, CSV."""
