"""What the server tells nodes of ROS 2 whose middleware is DDS (Fast DDS, Cyclone). Needs the extra `dds`."""
