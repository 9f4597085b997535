"""Random scenes of a crossing with exact ground truth: a sensor's observations and the messages of a vehicle."""
