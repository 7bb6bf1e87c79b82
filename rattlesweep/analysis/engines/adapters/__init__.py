"""What runs a case in a physics engine: a file for each, and a frame for all."""
