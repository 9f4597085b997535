"""Sensor-independent calibration: no files, no OpenCV."""
