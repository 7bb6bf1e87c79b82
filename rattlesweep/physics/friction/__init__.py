"""What the foot of a body does but roll, what that takes, and of what a patch is."""
