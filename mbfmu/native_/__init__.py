"""FMUs that need no Python: a compiled mechanism as data."""
