"""Pictures and words in which a person sees whether a calibration is right."""
