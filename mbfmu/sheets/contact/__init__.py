"""Contact of a sheet with rigid surfaces, and with the nips that drive it."""
