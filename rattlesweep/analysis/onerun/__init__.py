"""One run as a time series."""
