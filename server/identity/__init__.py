"""From centres to who is who."""
