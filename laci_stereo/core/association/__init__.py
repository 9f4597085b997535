"""Which track is the vehicle of which sender, and what would have to be wrong for others to fit."""
