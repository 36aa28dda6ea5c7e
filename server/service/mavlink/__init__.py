"""Poses for flight controllers: MAVLink 2 over UDP, as PX4 and ArduPilot take them from a motion capture system."""
