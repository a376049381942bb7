"""The vision unit: model of its measurements, errors, faults, transit and reception of its frames, cameras."""
