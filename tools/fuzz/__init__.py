"""Inputs that were damaged on purpose, for every reader."""
