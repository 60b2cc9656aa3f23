"""Recordings in other programs' formats: rosbag2, MCAP, LeRobot, Minari, Parquet, CSV."""
