"""The LEDs' positions, from a film of their robot."""
