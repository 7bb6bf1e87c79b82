"""What people look at: studies made with the sweeps' own parts, and their figures."""
