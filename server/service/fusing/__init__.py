"""`asterism fuse`, live: hears what cameras' servers publish, joins it, and publishes as a camera called `fused`."""
