"""The placement of the level frame in the world by either estimator, its uncertainty, and the objections to it.

An objection is a reason, in words, why the result may be wrong.
"""
