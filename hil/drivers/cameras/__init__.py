"""Cameras: GenICam by libaravis or GenTL, V4L2 by OpenCV; clocks, pairs, emulated GigE Vision cameras."""
