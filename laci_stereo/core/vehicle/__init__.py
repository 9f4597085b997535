"""The shape of a vehicle: its outline, how its body follows its front, and where it articulates."""
