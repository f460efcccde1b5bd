"""ROS 2 over zenoh: state and sensors out, a camera in."""
