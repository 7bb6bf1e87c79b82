"""What is looked for within a step: interpolation, marks, extremes."""
