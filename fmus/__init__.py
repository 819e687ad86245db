"""The models that ship with mbfmu, one folder each."""
