"""Logs of Cooperative Awareness Messages and of GNSS receivers, and the protocols that carry the messages."""
