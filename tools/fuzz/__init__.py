"""Fuzzing: deliberately damaged inputs for every reader."""
