"""Verification suite: problems with references that share no code with mbfmu, and the report of one command."""
