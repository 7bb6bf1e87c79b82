"""The pictures: from tables to Matplotlib figures."""
