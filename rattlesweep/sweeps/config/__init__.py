"""What a sweep is: configs, read and checked."""
