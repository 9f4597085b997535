"""Monitoring of long recordings from any sensor: object positions and traffic counts on the map."""
