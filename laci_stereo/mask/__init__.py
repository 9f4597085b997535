"""The optional vehicle mask: a network that the user brings tells which moving points are a vehicle's."""
