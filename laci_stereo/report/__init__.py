"""Pictures, text and the HTML page with which a person checks a calibration."""
