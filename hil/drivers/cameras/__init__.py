"""Cameras: GenICam by libaravis, pylon or GenTL, V4L2 by OpenCV; their clocks, pairs of frames, and emulated GigE Vision cameras."""
