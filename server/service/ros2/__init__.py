"""What the server tells nodes of ROS 2, on the wire of rmw_zenoh, in its own session."""
