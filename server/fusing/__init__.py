"""The frames of several cameras joined: one pose of every robot from all LEDs that all of them see."""
