"""The error budget of a rig, and its report."""
