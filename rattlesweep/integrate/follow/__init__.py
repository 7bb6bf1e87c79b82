"""One run past its reversals."""
