"""The joint estimate: residuals of all points of all drives, their priors, and the solution."""
