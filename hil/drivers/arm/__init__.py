"""Robot whose flange carries what rails and turntable would carry: one device that serves the axes of both."""
