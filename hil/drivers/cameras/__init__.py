"""Cameras: GenICam by libaravis, V4L2 by OpenCV; their clocks, pairs of frames, and emulated GigE Vision cameras."""
