"""World, LED optics and Z, from robots at surveyed poses."""
