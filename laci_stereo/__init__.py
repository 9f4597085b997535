"""Find where a roadside sensor stands and looks, from one connected vehicle that drives by."""
