"""Studies of a model: what accuracy costs, what effects cost and change, and pictures of it all."""
