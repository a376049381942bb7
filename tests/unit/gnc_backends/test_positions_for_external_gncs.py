"""An external GNC, whose input has no status of a pose, receives no attitude that is a guess."""

from __future__ import annotations

import numpy as np

from hil.core.gnc_records import GNC_INPUT
from hil.core.messages import IMU, POSE, POSITION_ONLY, REFERENCE, new
from hil.gnc_backends.external_records import write_input


def test_positions_alone_are_left_out() -> None:
    poses, sent = np.zeros(3, POSE).view(np.recarray), new(GNC_INPUT)
    poses.t_s, poses.status = [0.1, 0.2, 0.3], [0, POSITION_ONLY, 0]
    write_input(1, 0.3, 0, 0, new(IMU), new(REFERENCE), poses, 3, sent)
    assert sent.n_poses == 2
    assert sent.poses["t_s"][:2].tolist() == [0.1, 0.3]
