"""Models as machine code that needs no Python where it runs: one runtime for all, and a block of data for each."""
