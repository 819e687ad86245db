"""Adams PECE, of variable order and step."""
