"""What every other package uses: errors and codes of messages, files, text tables, units, optional packages."""
