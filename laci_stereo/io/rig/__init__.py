"""Stereo calibrations in the formats of the tools that write them."""
