"""Reading what users have, writing what they need."""
