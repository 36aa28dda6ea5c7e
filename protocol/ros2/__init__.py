"""ROS 2 without ROS: names and types, what Asterism publishes as the values ROS has for it, and those as CDR."""
