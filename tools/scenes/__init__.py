"""Random scenes of a crossing with exact truth: what a sensor sees of them, and what a vehicle says meanwhile."""
