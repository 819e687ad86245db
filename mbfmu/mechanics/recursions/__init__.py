"""The equations of motion by recursions over the tree."""
