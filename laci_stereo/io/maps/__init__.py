"""Lane maps: their lines, and the lanes between them."""
