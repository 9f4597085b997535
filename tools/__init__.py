"""Scene generator and benchmarks, for maintainers."""
