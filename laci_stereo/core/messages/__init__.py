"""Cooperative Awareness Messages: checked, repaired, and turned into the track of a vehicle in the world frame."""
