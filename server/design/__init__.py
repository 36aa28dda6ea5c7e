"""Constellations that cannot be confused, their plates, and the check of a rig."""
