"""Random mechanisms in one neutral description, evaluated by mbfmu and by other engines that are installed."""
