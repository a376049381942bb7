"""IMU of a lab on a wire of its own."""
