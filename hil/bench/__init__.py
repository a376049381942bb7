"""The six-axis motion simulator: from the pose of the chaser to rails and turntable, and back."""
