"""Whether a map's lines lie on the road's: paint found in what a sensor saw, held against a calibration."""
