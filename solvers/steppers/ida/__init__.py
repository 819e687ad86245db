"""SUNDIALS IDA on index-reduced equations."""
