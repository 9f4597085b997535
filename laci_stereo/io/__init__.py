"""Readers of the formats that users have, and writers of those that they need."""
