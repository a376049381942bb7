"""A position-controlled axis with lag, speed and acceleration limits and end stops.

The bench's mocks and the device emulators move by this one model: a position loop of gain ``kp``
with velocity feed-forward, a drive that follows its speed command as a first-order lag ``tau``.
"""

from __future__ import annotations

from hil.maths.jit import kernel


@kernel
def servo_step(position, rate, setpoint, feedforward, kp, tau, rate_max, acceleration_max, low, high, dt):
    """Move axes on by ``dt``, s, in place. All arguments but ``dt`` are arrays of shape (n,).

    position, rate: state, m and m/s (or rad and rad/s). setpoint, feedforward: wanted position and
    its rate. kp: 1/s. tau: s. rate_max, acceleration_max: limits. low, high: end stops, where the
    axis stands still. The step is split so that it stays well inside the lag. Neighbours of the same lag
    go through its parts side by side: a part waits for the one before it, another axis does not.
    """
    first = 0
    while first < position.shape[0]:
        end = first + 1
        while end < position.shape[0] and tau[end] == tau[first]:
            end += 1
        n = int(dt / (0.25 * tau[first])) + 1
        h = dt / n
        for _ in range(n):
            for i in range(first, end):
                wanted = feedforward[i] + kp[i] * (setpoint[i] - position[i])
                wanted = min(rate_max[i], max(-rate_max[i], wanted))
                acceleration = (wanted - rate[i]) / tau[i]
                acceleration = min(acceleration_max[i], max(-acceleration_max[i], acceleration))
                rate[i] += acceleration * h
                position[i] += rate[i] * h
                if position[i] < low[i]:
                    position[i] = low[i]
                    rate[i] = 0.0
                elif position[i] > high[i]:
                    position[i] = high[i]
                    rate[i] = 0.0
        first = end
