"""Conversion of image pairs to point clouds: rectification, disparity, reprojection."""
