"""Vision measurement unit: poses with covariance from stereo images of an LED ring."""
