"""A small GNC for the bench, over UDP: a complementary filter on poses and IMU, on/off control with a dead band.

    hil dss scheme-1 --lock-step &              # on the computer of the bench
    python gnc.py 127.0.0.1 24500               # on this one: address and port of hil dss

It needs only numpy. Datagrams: docs/reference/wire-formats.md, records: docs/how-to/connect-your-gnc.md.
Frames: H is the target's Hill frame, c the chaser's body frame; q_CH, scalar last, transforms components in H to
components in c.
"""

import contextlib
import hmac
import os
import socket
import struct
import sys
import time
import zlib

import numpy as np

HEADER = struct.Struct("<4sIBBHHHIId")
HELLO, CELL, HEARTBEAT, GOODBYE, REFUSED = range(1, 6)
SETUP_CELL, INPUT_CELL, OUTPUT_CELL, ORBIT_CELL = 1, 2, 3, 24
OFFERS, WANTS = 1, 2
RUNNING = 2
WORKING = 1
SILENT = 20  # consecutive time-outs after which hello is sent again

SETUP = np.dtype(
    [
        ("scenario", "S32"), ("step_s", "<f8"), ("duration_s", "<f8"), ("mean_motion_radps", "<f8"),
        ("mass_kg", "<f8"), ("inertia_kgm2", "<f8", (3, 3)), ("n_thrusters", "<i8"),
        ("thruster_position_m", "<f8", (24, 3)), ("thruster_force_N", "<f8", (24, 3)), ("minimum_on_s", "<f8"),
        ("acceleration_mps2", "<f8", 3), ("angular_acceleration_radps2", "<f8", 3), ("start_r_CT_H_m", "<f8", 3),
        ("start_q_CH", "<f8", 4), ("ready_point_m", "<f8", 3), ("closing_rate_max_mps", "<f8"),
    ]
)  # fmt: skip
ORBIT = np.dtype(
    [
        ("eccentricity", "<f8"), ("mean_anomaly_rad", "<f8"), ("tumbles", "<i8"), ("target_rate_radps", "<f8", 3),
        ("target_inertia_kgm2", "<f8", (3, 3)),
    ]
)  # fmt: skip
POSE = np.dtype(
    [
        ("t_s", "<f8"), ("r_TC_C_m", "<f8", 3), ("q_CH", "<f8", 4),
        ("covariance_position_m2", "<f8", (3, 3)), ("covariance_attitude_rad2", "<f8", (3, 3)),
    ]
)  # fmt: skip
INPUT = np.dtype(
    [
        ("cycle", "<i8"), ("t_s", "<f8"), ("mode", "<i4"), ("orders", "<i4"), ("rate_radps", "<f8", 3),
        ("force_mps2", "<f8", 3), ("reference_r_CT_H_m", "<f8", 3), ("reference_v_CT_H_mps", "<f8", 3),
        ("reference_a_CT_H_mps2", "<f8", 3), ("reference_q_CH", "<f8", 4), ("boost", "<i8"), ("n_poses", "<i8"),
        ("poses", POSE, 4),
    ]
)  # fmt: skip
OUTPUT = np.dtype(
    [
        ("cycle", "<i8"), ("state", "<i4"), ("direct", "<i4"), ("force", "<i4", 3), ("torque", "<i4", 3),
        ("on", "u1", 24), ("estimate", "<i8"), ("r_CT_H_m", "<f8", 3), ("v_CT_H_mps", "<f8", 3),
        ("q_CH", "<f8", 4), ("w_CH_C_radps", "<f8", 3), ("text", "S64"),
        ("protection_level_m", "<f8", 3), ("protection_level_rad", "<f8"), ("health", "<i8"),
    ]
)  # fmt: skip


def matrix_of(q):
    """Return the matrix that transforms components in H to components in c."""
    v, s = q[:3], q[3]
    cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return (s * s - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) - 2.0 * s * cross


def rotated(q, phi):
    """Return ``q`` after a rotation of c by the small rotation vector ``phi``, rad, in c."""
    v, s, half = q[:3], q[3], 0.5 * phi
    p = np.append(v + s * half - np.cross(half, v), s - half @ v)
    return p / np.linalg.norm(p)


def rotation_between(start, end):
    """Return the rotation vector, rad, in c, from the attitude ``start`` to ``end``; valid for small angles."""
    vector = start[3] * end[:3] - end[3] * start[:3] + np.cross(end[:3], start[:3])
    return 2.0 * vector * (-1.0 if start @ end < 0.0 else 1.0)


class Frame:
    """H at a time: rate against inertial space, rad/s, and its change, in H, and the gravity gradient, 1/s^2."""

    def __init__(self, setup, orbit):
        self.n, self.e = float(setup["mean_motion_radps"]), float(orbit["eccentricity"])
        self.mean_anomaly = float(orbit["mean_anomaly_rad"])
        self.tumbles, self.inertia = bool(orbit["tumbles"]), orbit["target_inertia_kgm2"]
        self.t_s, self.w = 0.0, orbit["target_rate_radps"].copy()

    def at(self, t_s):
        if self.tumbles:
            return self.of_body(t_s)
        mean = anomaly = self.mean_anomaly + self.n * t_s
        for _ in range(20):
            anomaly = mean + self.e * np.sin(anomaly)  # Kepler's equation
        nu = 2.0 * np.arctan(np.sqrt((1.0 + self.e) / (1.0 - self.e)) * np.tan(0.5 * anomaly))
        rho = 1.0 + self.e * np.cos(nu)
        rate = self.n * rho**2 / (1.0 - self.e**2) ** 1.5
        change = -2.0 * self.e * np.sin(nu) * rate**2 / rho
        k = self.n**2 * (rho / (1.0 - self.e**2)) ** 3
        return np.array([0.0, -rate, 0.0]), np.array([0.0, -change, 0.0]), k * np.array([-1.0, -1.0, 2.0])

    def of_body(self, t_s):
        """Integrate Euler's equations to ``t_s``; gravity in these axes is small against their motion and left out."""
        dt, w = t_s - self.t_s, self.w
        middle = w + 0.5 * dt * self.change(w)
        self.t_s, self.w = t_s, w + dt * self.change(middle)
        return self.w, self.change(self.w), np.zeros(3)

    def change(self, w):
        return np.linalg.solve(self.inertia, -np.cross(w, self.inertia @ w))


class Navigation:
    """Position, velocity and attitude: predicted with the IMU, corrected by each pose."""

    BANDWIDTH_RADPS = 0.15  # of the position observer
    ATTITUDE_GAIN = 0.15  # fraction of an attitude difference that a pose corrects
    LONGEST_GAP_S = 1.0  # between poses; limits the gain
    SETTLED_S = 10.0  # after the first pose; from then on the estimate is sent

    def __init__(self, setup, orbit):
        self.dt, self.frame = float(setup["step_s"]), Frame(setup, orbit)
        self.started = False
        self.settled = False

    def step(self, data):
        """Take the IMU's sample and the poses of an input."""
        now_s = float(data["t_s"])
        if self.started:
            self.predict(now_s, data["rate_radps"], data["force_mps2"])
        for pose in data["poses"][: data["n_poses"]]:
            if self.started:
                self.correct(now_s, pose)
            else:
                self.start(pose, data["reference_v_CT_H_mps"])
        self.settled = self.started and now_s > self.first_s + self.SETTLED_S

    def start(self, pose, v):
        self.q, self.v = pose["q_CH"].copy(), v.copy()
        self.r = -matrix_of(self.q).T @ pose["r_TC_C_m"]
        self.w, self.bias = np.zeros(3), np.zeros(3)
        self.first_s = self.pose_s = float(pose["t_s"])
        self.sigma_m = 0.0
        self.started = True

    def predict(self, now_s, rate, force):
        a, dt = matrix_of(self.q), self.dt
        w, change, gradient = self.frame.at(now_s)
        self.w = rate - a @ w  # the gyro also measures the rotation of H
        r, v = self.r, self.v
        free = gradient * r - 2.0 * np.cross(w, v) - np.cross(w, np.cross(w, r)) - np.cross(change, r)
        dv = dt * (a.T @ (force - self.bias) + free)
        self.r, self.v = r + dt * v + 0.5 * dt * dv, v + dv
        self.q = rotated(self.q, dt * self.w)

    def correct(self, now_s, pose):
        age_s, gap_s = now_s - float(pose["t_s"]), float(pose["t_s"]) - self.pose_s
        if gap_s <= 0.0:
            return  # a duplicate, or older than the newest one
        self.pose_s, gap_s = float(pose["t_s"]), min(gap_s, self.LONGEST_GAP_S)
        self.sigma_m = float(np.sqrt(np.trace(pose["covariance_position_m2"]) / 3.0))
        then = rotated(self.q, -age_s * self.w)  # at the time of exposure
        correction = self.ATTITUDE_GAIN * rotation_between(then, pose["q_CH"])
        self.q, then = rotated(self.q, correction), rotated(then, correction)
        a = matrix_of(then)
        error = -a.T @ pose["r_TC_C_m"] - (self.r - age_s * self.v)
        b = self.BANDWIDTH_RADPS  # three poles at -b, as gains for one gap
        self.r = self.r + 3 * b * gap_s * error
        self.v = self.v + 3 * b**2 * gap_s * error
        self.bias = self.bias - b**3 * gap_s * (a @ error)


class Control:
    """On/off control of error + lead * rate per axis: fires from the edge of a dead band back to a fraction of it."""

    LEAD_S = np.array([5.0] * 3 + [2.5] * 3)
    DEAD_BAND = np.array([6e-3] * 3 + [2e-3] * 3)  # m, rad
    RELEASE = np.array([0.4] * 3 + [0.3] * 3)
    REACH = LEAD_S * np.array([0.01] * 3 + [5e-3] * 3)  # limits the rate at which an error is corrected

    def __init__(self):
        self.firing = np.zeros(6, dtype=int)

    def step(self, data, nav):
        """Return the six demands."""
        a = matrix_of(nav.q)
        error = np.append(a @ (nav.r - data["reference_r_CT_H_m"]), rotation_between(data["reference_q_CH"], nav.q))
        rate = np.append(a @ (nav.v - data["reference_v_CT_H_mps"]), nav.w)
        s = np.clip(error, -self.REACH, self.REACH) + self.LEAD_S * rate
        band = self.DEAD_BAND + np.array([nav.sigma_m] * 3 + [0.0] * 3)
        edge = np.where(self.firing * s < 0.0, self.RELEASE * band, band)
        self.firing = np.where(s > edge, -1, np.where(s < -edge, 1, 0))
        return self.firing


class Gnc:
    def __init__(self, setup, orbit):
        self.navigation, self.control = Navigation(setup, orbit), Control()

    def answer(self, data):
        """Return the output for an input."""
        out = np.zeros((), OUTPUT)
        out["cycle"], out["state"] = data["cycle"], WORKING
        if data["mode"] != RUNNING:
            return out
        nav = self.navigation
        nav.step(data)
        if nav.started:
            demands = self.control.step(data, nav)
            out["force"], out["torque"] = demands[:3], demands[3:]
            out["estimate"] = nav.settled
            out["r_CT_H_m"], out["v_CT_H_mps"] = nav.r, nav.v
            out["q_CH"], out["w_CH_C_radps"] = nav.q, nav.w
        return out


class Wire:
    """Datagrams to and from the bench."""

    def __init__(self, host, port):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect((host, port))
        self.socket.settimeout(0.1)
        self.writer = (int(time.time() * 1000) ^ os.getpid() << 16) & 0xFFFFFFFF
        self.bench = 0  # writer number of the bench, from its datagrams
        self.counts = {}
        folder = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
        path = os.environ.get("HIL_KEY_FILE") or f"{folder}/hil/gnc-link.key"  # as of hil dss --key-file
        while not os.path.exists(path):  # hil dss makes it
            time.sleep(0.1)
        with open(path) as file:
            self.key = file.read().strip().encode()

    def tag(self, datagram, receiver):
        """Return the 16 bytes behind a datagram: a bench is started and flown by holders of the key."""
        kind, cell = struct.unpack_from("<9xBH", datagram)
        begins = kind in (HELLO, REFUSED) or (kind == CELL and cell == SETUP_CELL)
        return hmac.digest(self.key, struct.pack("<I", 0 if begins else receiver) + datagram, "sha256")[:16]

    def send(self, kind, cell, payload):
        self.counts[kind] = self.counts.get(kind, 0) + 1
        now_s = time.monotonic()
        head = HEADER.pack(b"FRMN", 0, 2, kind, cell, len(payload), 0, self.writer, self.counts[kind], now_s)
        crc = zlib.crc32(head[8:] + payload)
        with contextlib.suppress(ConnectionRefusedError):  # the bench is not listening yet
            datagram = head[:4] + struct.pack("<I", crc) + head[8:] + payload
            self.socket.send(datagram + self.tag(datagram, self.bench))

    def hello(self):
        wanted = ((SETUP_CELL, SETUP), (INPUT_CELL, INPUT), (ORBIT_CELL, ORBIT))
        cells = [(OUTPUT_CELL, OUTPUT, OFFERS), *((*cell, WANTS) for cell in wanted)]
        entries = b"".join(struct.pack("<4H", number, dtype.itemsize, 0, use) for number, dtype, use in cells)
        self.send(HELLO, 0, struct.pack("<ii32s", 2, len(cells), b"gnc.py") + entries.ljust(128, b"\0"))

    def receive(self):
        """Return (kind, cell, payload) of a valid datagram, None after 0.1 s without one."""
        try:
            datagram = self.socket.recv(2048)
        except (TimeoutError, ConnectionRefusedError):
            return None
        datagram, tag = datagram[:-16], datagram[-16:]
        if len(datagram) < HEADER.size or not hmac.compare_digest(tag, self.tag(datagram, self.writer)):
            return None
        magic, crc, version, kind, cell, size, _, self.bench, *_ = HEADER.unpack_from(datagram)
        payload = datagram[HEADER.size :]
        if (magic, version, size, crc) != (b"FRMN", 2, len(payload), zlib.crc32(datagram[8:])):
            return None
        return kind, cell, payload


def main(host, port):
    wire, setup, gnc, last, answer, silent = Wire(host, port), None, None, None, None, 0
    while True:
        received = wire.receive()
        if received is None:
            silent += 1
            if gnc is None or silent > SILENT:
                time.sleep(0.02)
                wire.hello()
            continue
        silent = 0
        kind, cell, payload = received
        if kind == GOODBYE:
            return 0
        if kind == REFUSED:
            print("refused by the bench:", payload[4:].rstrip(b"\0").decode(errors="replace"), file=sys.stderr)
            return 2
        if kind == CELL and cell == SETUP_CELL and len(payload) == SETUP.itemsize:
            setup = np.frombuffer(payload, SETUP)[0]
            continue
        if kind == CELL and cell == ORBIT_CELL and len(payload) == ORBIT.itemsize and setup is not None:
            gnc, last = Gnc(setup, np.frombuffer(payload, ORBIT)[0]), None
            answer = np.zeros((), OUTPUT)
            answer["cycle"], answer["state"] = -1, WORKING
        elif kind == CELL and cell == INPUT_CELL and len(payload) == INPUT.itemsize and gnc is not None:
            data = np.frombuffer(payload, INPUT)[0]
            if (data["cycle"], data["mode"]) != last:  # otherwise the reply was lost: send it again
                answer, last = gnc.answer(data), (data["cycle"], data["mode"])
        else:
            continue
        wire.send(CELL, OUTPUT_CELL, answer.tobytes())


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: gnc.py HOST PORT, those of hil dss")
    sys.exit(main(sys.argv[1], int(sys.argv[2])))
