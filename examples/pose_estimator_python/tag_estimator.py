"""Pose estimator for hil: five AprilTags on a board, in two calibrated cameras, jointly by least squares."""

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hil.vmu.boards import refined
from hil.vmu.estimators import PRINT, FlatTarget, PoseEstimate
from hil.vmu.prints import AprilTagSettings

SIDES_M = {0.0: 0.06, -0.12: 0.14, 0.12: 0.14, -0.42: 0.36, 0.42: 0.36}  # x of tags 0 to 4, m: side
TAGS = AprilTagSettings(tags=tuple((k, side, x, 0.0) for k, (x, side) in enumerate(SIDES_M.items())))
CORNER_PX, CALIBRATION_PX, PER_M, SIZE_M = 0.1, 0.05, 3000, (1.3, 0.5)


class BoardEstimator:  # its ``board`` is what emulated cameras draw
    def __init__(self, geometry, settings):
        self.print, way = geometry.print, geometry.print or "official"  # of OpenCV they are turned by 180 deg
        self.detector = cv2.aruco.ArucoDetector(TAGS.dictionary())
        self.points, self.shift = TAGS.corners(), TAGS.shift(way)
        self.lenses = [
            (np.array([[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]]), np.array(c.distortion))
            for c in (geometry.left, geometry.right)
        ]
        self.turn, self.base = Rotation.from_rotvec(geometry.right_rotation_rad).inv(), np.array(geometry.baseline_m)
        picture = np.full([round(PER_M * size) for size in SIZE_M[::-1]], 255, np.uint8)
        for k, side, x, _ in TAGS.tags:
            pixels = round(PER_M * side)
            u, v = (np.array(picture.shape[::-1]) - pixels) // 2 + [round(PER_M * x), 0]
            picture[v : v + pixels, u : u + pixels] = TAGS.marker(k, way, pixels)
        self.board = FlatTarget(picture, *SIZE_M)

    def warm_up(self):
        """OpenCV compiles nothing."""

    def project(self, side, ids, x):
        """Return the pixels (n, 2) of corners in a camera, for x: rotation vector and position of the board."""
        p = Rotation.from_rotvec(x[:3]).apply(self.points[ids]) + x[3:]
        p = self.turn.apply(p - self.base) if side else p
        return cv2.projectPoints(p, np.zeros(3), np.zeros(3), *self.lenses[side])[0].reshape(-1, 2)

    def find(self, image):
        """Return numbers and pixels (n, 2) of the corners in an image."""
        quads, tags, _ = ((), None, ()) if image is None else self.detector.detectMarkers(image)
        ids, pixels = [], []
        for quad, k in zip(quads, np.ravel(tags), strict=False):
            corners = refined(image, np.reshape(quad, (4, 2)), 8) if k < len(TAGS.tags) else None
            if corners is not None:
                ids += [4 * k + (n + self.shift) % 4 for n in range(4)]
                pixels += corners.tolist()
        return ids, np.reshape(pixels, (-1, 2))

    def solve(self, left, right, t_s):
        """Return the pose by the images (h, w), uint8, at t_s; None for a missing image."""
        found = [self.find(image) for image in (left, right)]
        if min(len(ids) for ids, _ in found) < 4:
            return PoseEstimate(t_s, "too_few")
        if self.print is None and len({k // 4 for ids, _ in found for k in ids}) == 1:
            return PoseEstimate(t_s, PRINT)  # a single tag fits both prints
        (ids, pixels), lens = found[0], self.lenses[0]
        _, turn, place = cv2.solvePnP(self.points[ids], pixels, *lens, flags=cv2.SOLVEPNP_IPPE)

        def residuals(x):
            errors = [self.project(s, seen, x) - at for s, (seen, at) in enumerate(found)]
            return np.concatenate(errors).ravel() / CORNER_PX

        fit = least_squares(residuals, np.concatenate([turn.ravel(), place.ravel()]), x_scale="jac")
        turn, t_v = Rotation.from_rotvec(fit.x[:3]), fit.x[3:]
        if 2.0 * fit.cost > 4.0 * len(fit.fun) or not t_v[2] > 0.0:
            return PoseEstimate(t_s, "rejected_no_match")
        step = 1e-6 * np.eye(3)  # the covariance is of the position and of a small rotation about v's axes
        slope = np.array([(Rotation.from_rotvec(fit.x[:3] + d) * turn.inv()).as_rotvec() for d in step]).T / 1e-6
        change = np.block([[np.zeros((3, 3)), np.eye(3)], [slope, np.zeros((3, 3))]])
        noise = change @ np.linalg.inv(fit.jac.T @ fit.jac) @ change.T
        whole = noise.copy()  # with an error of the calibration: of the disparity, alike in all images
        range_sigma_m = CALIBRATION_PX * t_v[2] ** 2 / (lens[0][0, 0] * np.linalg.norm(self.base))
        whole[:3, :3] += range_sigma_m**2 * np.outer(t_v, t_v) / (t_v @ t_v)
        return PoseEstimate(t_s, "ok", t_v, turn.inv().as_quat(), whole, noise)
