"""From a config to cases, bodies and launch states."""
