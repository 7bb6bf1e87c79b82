"""What a directory holds, and what can be done with it without integrating."""
