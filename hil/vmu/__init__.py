"""The vision measurement unit: stereo images of an LED ring become poses with their covariance."""
