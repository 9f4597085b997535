"""Results of this project, their evidence, and their exchange with other tools."""
