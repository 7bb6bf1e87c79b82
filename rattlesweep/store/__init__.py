"""What is on disk: rows, manifests, locks, summaries."""
