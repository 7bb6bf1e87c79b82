"""What is to be run: configs, bodies, cases, launches."""
