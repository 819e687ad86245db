"""What a run does at communication points: kernels that Python calls and that the native runtime links."""
