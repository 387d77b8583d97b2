"""Logs and results to look at: over the wire to Foxglove and Lichtblick, or as a page that plays in any browser."""
