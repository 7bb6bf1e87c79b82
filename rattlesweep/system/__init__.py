"""The machine: files, locks, processors, the terminal, pages."""
