"""From an image to bright spots."""
