"""One run as a page on which the body rolls."""
