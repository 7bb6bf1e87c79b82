"""What the figures show: one module a figure, from runs and bodies to tables."""
