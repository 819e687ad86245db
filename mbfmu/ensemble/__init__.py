"""Many runs: what varies from one to the next, what is measured of each, and who makes them."""
