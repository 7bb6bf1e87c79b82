"""What a lane knows: its fields, and how compiled code sees them."""
