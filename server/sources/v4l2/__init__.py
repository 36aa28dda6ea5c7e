"""V4L2 cameras, by the calls of the kernel itself."""
