"""From a mesh to a body: solid, mass, rest, and the curvature of the bottom."""
