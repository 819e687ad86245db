"""One run: from the start through communication points to its result, and what is checked on the way."""
