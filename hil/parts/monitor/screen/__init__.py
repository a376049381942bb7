"""Screen of the docking monitor: overlay, plots, drawing."""
