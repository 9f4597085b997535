"""The ground plane: where the road is, how it is shaped, and how uncertain that is."""
