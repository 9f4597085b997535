"""Whether a map's lines lie on the road's: paint, kerbs and walls that a sensor saw, held against a calibration."""
