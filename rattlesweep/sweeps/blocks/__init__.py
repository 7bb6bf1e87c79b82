"""One block, from its number to its columns."""
