"""What people look at: pictures, reports, single runs, speed against accuracy."""
