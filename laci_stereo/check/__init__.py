"""Checks of a calibration against a map's lines (paint, kerbs, walls), and of a stereo calibration against images."""
