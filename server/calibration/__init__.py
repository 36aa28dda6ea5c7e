"""What finds a rig's errors and removes them."""
