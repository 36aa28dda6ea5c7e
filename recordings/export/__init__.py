"""Export: what a recording tells of its robots, in files that other programs read: CSV, TUM, Parquet, ROS 2 bags."""
