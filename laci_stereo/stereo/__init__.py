"""Image pairs in, rectified disparity, point clouds out."""
