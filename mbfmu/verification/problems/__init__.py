"""Problems of the suite, one module per family."""
