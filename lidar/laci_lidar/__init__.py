"""LiDAR recordings as a source of point clouds for the calibration core."""
