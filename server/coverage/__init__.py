"""Where tools have been on the surface: how long, how often, how fast and when, patch by patch."""
