"""The report: what a scan left in its folder, as one page for a browser. Reads files, never runs a scan."""
