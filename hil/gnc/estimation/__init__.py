"""Navigation: from poses, IMU, sensors and commands to the estimate of the motion, its covariance and its integrity."""
