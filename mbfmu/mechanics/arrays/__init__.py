"""From the builder's objects to flat arrays, and a compiled mechanism at work."""
