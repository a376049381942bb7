"""Cameras: GenICam by libaravis, pylon or GenTL, V4L2 by OpenCV; clocks, pairs, emulated GigE Vision cameras."""
